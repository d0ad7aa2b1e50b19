"""`tomojax compile-step`: writes a step as a C library."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from tomojax._require import require
from tomojax.cli import entry
from tomojax.cli.rigs._options import check_step, step_options


@click.command(cls=entry.Command)
@step_options
@click.option(
    "--policy",
    "policies",
    multiple=True,
    help="Choose the next grounds by this policy: a name of tomojax.step.POLICIES, "
    "electrodes as 0,7,14, or a table of `tomojax design --policy`. May be repeated: a "
    "program may switch between them. [default: around_contacts]",
)
@click.option(
    "--rate", type=entry.AMOUNT, default=10_000.0, help="Slots a second, of the rig."
)
@entry.like_option
@entry.calibration_option
@click.option(
    "--march",
    default="native",
    help="Compile for this processor, a name that the compiler knows. [default: this one]",
)
@click.option("--source", is_flag=True, help="Write the source alone: compile nothing.")
@click.option(
    "--full-tables/--half-tables",
    default=True,
    help="Keep 32 bits of each number, or 16 of the largest tables': about half the bytes.",
)
@entry.out_option(
    entry.OutputFolder("tomojax_step.h", goes_on=True),
    "Folder for the library and its files.",
    default="step",
)
def compile_step(
    method: str,
    policies: tuple[str, ...],
    cheaper: str | None,
    contacts: int,
    rate: float,
    like: Path | None,
    calibration: Path | None,
    march: str,
    source: bool,
    full_tables: bool,
    out: Path,
) -> None:
    """Write a step as C: for programs, threads and boards that have no Python.

    The folder gets a library for this machine, its source, the tables of the rig, a header
    for C and one for C++17, an example, and test vectors. Another rig of the same shape
    takes the same library and its own tables.
    """
    names = policies or ("around_contacts",)
    check_step(method, cheaper, names)
    for option, name in (("--method", method), ("--cheaper", cheaper or method)):
        told = "follow, points, source or linear: this one has no C"
        require(name not in ("auto", "shape"), option, repr(name), told)
    rig, _, electrodes = entry.sheet_of(like)
    if not source:
        _try_compiler(march)

    import numpy as np

    from tomojax.sensor import Calibration, Sensor
    from tomojax.step import compile as compile_, load_policy, make_step

    sensor = Sensor.grid() if rig is None else rig.sensor(dtype=np.float32)
    known = None if calibration is None else Calibration.load(calibration, electrodes)
    tables: dict[str, Any] = {
        name: load_policy(name, sensor) for name in names if name.endswith(".npz")
    }
    made = make_step(
        sensor,
        method,
        list(names),
        contacts=contacts,
        f_switch=rate,
        cheaper=cheaper,
        calibration=known,
        tables=tables,
        native=False,
    )
    code = compile_(made, out, march=march, libraries=not source, halved=not full_tables)
    size = (out / "step.tables").stat().st_size / 1e6
    print(f"{out}: a step of {method}, code {code}, tables of {size:.1f} MB")
    code = "step.c" if source else "libtomojax_step.a"
    print("these try its test vectors:")
    print(f"cc {out}/check.c {out}/{code} -I{out} -lm -o check")
    print(f"./check {out}/step.tables {out}/vectors.bin")


def _try_compiler(march: str) -> None:
    """Compiles next to nothing: a mistake is told before a step is made, in seconds.

    **Raises:** `ValueError` where no compiler is there, and for a processor unknown to it.
    """
    from tomojax.native import compile_c

    with TemporaryDirectory() as folder:
        file = Path(folder) / "nothing.c"
        file.write_text("int nothing;\n")
        compile_c(file, file.with_suffix(".o"), "-c", f"-march={march}")
