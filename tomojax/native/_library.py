"""Lets the compiler that is there make libraries of C that was written."""

import os
import shutil
import subprocess
from pathlib import Path

from tomojax._require import require

# XLA's own choices of arithmetic, said to the compiler: products and sums may be rounded
# once, and a sum goes in lanes where the code says so. NaN, infinities and signs of zero
# are kept, which "fast" arithmetic would give up.
FLAGS = (
    "-std=gnu99",
    "-O3",
    "-fPIC",
    "-fopenmp-simd",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-ffp-contract=fast",
)


def compiler() -> str | None:
    """Returns the C compiler: what CC names, or the first that is there; None for none.

    **Example:**

    >>> from tomojax.native import compiler
    >>> compiler() is None or compiler().startswith("/")
    True
    """
    names = [os.environ["CC"]] if os.environ.get("CC") else ["cc", "gcc", "clang"]
    return next((found for name in names if (found := shutil.which(name))), None)


# The same without any optimisation, to check what an optimiser has made: GCC 12.2 takes
# wrong lanes of masks in small loops, where masks and numbers are of unlike widths.
PLAIN = ("-O0",)


def compile_c(source: Path, target: Path, *flags: str) -> None:
    """Compiles one file of C: to a shared library, or what `flags` and CFLAGS ask for.

    **Raises:** `ValueError` where no compiler is there, or where it fails.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.native import compile_c, compiler
    >>> count = Path("one.c").write_text("int one(void) { return 1; }")
    >>> if compiler() is not None:
    ...     compile_c(Path("one.c"), Path("one.so"))
    """
    found = compiler()
    require(
        found is not None, "compiler", "none", "a C compiler: cc, gcc, clang, or CC=..."
    )
    shared = () if "-c" in flags else ("-shared",)
    own = os.environ.get("CFLAGS", "").split()
    command = [str(found), *FLAGS, *shared, *flags, *own, str(source), "-o", str(target)]
    command += [] if "-c" in flags else ["-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        told = next(
            (x for x in done.stderr.splitlines() if "error" in x), done.stderr[:200]
        )
        raise ValueError(f"compiler: {found} failed: {told.strip()}")


def make_archive(objects: Path, target: Path) -> None:
    """Makes a static library of an object file.

    **Raises:** `ValueError` where no `ar` is there, or where it fails.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.native import compile_c, compiler, make_archive
    >>> count = Path("one.c").write_text("int one(void) { return 1; }")
    >>> if compiler() is not None:
    ...     compile_c(Path("one.c"), Path("one.o"), "-c")
    ...     make_archive(Path("one.o"), Path("libone.a"))
    """
    ar = os.environ.get("AR") or shutil.which("ar")
    require(ar is not None, "archiver", "none", "`ar`, which comes with a compiler")
    target.unlink(missing_ok=True)
    done = subprocess.run(
        [str(ar), "rcs", target, objects], capture_output=True, check=False
    )
    require(done.returncode == 0, "archiver", f"{ar} failed", "a static library")
