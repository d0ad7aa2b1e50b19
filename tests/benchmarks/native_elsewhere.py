"""Runs a step's test vectors elsewhere: Arm, a board, an empty root, sanitizers.

    python tests/benchmarks/native_elsewhere.py [--shape SHAPE] [--out FOLDER]

Needs gcc, and where they are there: aarch64-linux-gnu-gcc and arm-linux-gnueabihf-gcc with
qemu-user, arm-none-eabi-gcc with newlib and qemu-system-arm, valgrind, chroot (as root).
Each row says what the vectors gave: slots that differ from JAX's program in flags, count or
next condition, and places that are away.
Writes native_elsewhere.json.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1])]

from tomojax.native import FLAGS  # noqa: E402

SHAPES = ("64 electrodes", "4 x 4", "two grounds at once")
ARM = {
    "Arm 64": ("aarch64-linux-gnu-gcc", "qemu-aarch64", "-march=armv8-a"),
    "Arm 32": ("arm-linux-gnueabihf-gcc", "qemu-arm", "-mfpu=neon-vfpv4"),
}
HOSTILE = 10**6
M7 = "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16".split()
QEMU = "qemu-system-arm -M mps2-an500 -nographic -semihosting -icount shift=0".split()


def compiled(shape: str, folder: Path) -> float:
    """Writes and compiles a step; returns the seconds it took."""
    import numpy as np

    import tomojax as tx

    begun = time.perf_counter()
    given = {
        "64 electrodes": {},
        "4 x 4": {"rows": 4, "columns": 4, "divisions": (20, 20)},
        # Each with the one opposite, through 4 Ω each.
        "two grounds at once": {"conditions": (np.eye(64) + np.eye(64)[::-1])[:32] / 4},
    }
    sensor = tx.Sensor.grid(**given[shape], dtype=np.float32)
    step = tx.make_step(sensor, "follow", ["around_contacts"], contacts=2, native=False)
    tx.step.compile(step, folder, halved=True)
    return time.perf_counter() - begun


def told(command: list, **more) -> dict:
    done = subprocess.run(command, capture_output=True, text=True, check=False, **more)
    found = re.search(r"(\d+) slots: (\d+) differ, (\d+) places are away", done.stdout)
    if found is None:
        return {"failed": (done.stderr or done.stdout)[-300:]}
    slots, differ, away = map(int, found.groups())
    return {"slots": slots, "differ": differ, "away": away, "status": done.returncode}


def checker(cc: str, folder: Path, to: Path, *flags: str) -> Path:
    sources = [folder / "check.c", folder / "step.c"]
    command = [cc, *FLAGS, *flags, f"-I{folder}", *sources, "-lm", "-o", to]
    subprocess.run(command, check=True)
    return to


def instructions(folder: Path, to: Path) -> dict:
    """Counts by callgrind; AVX2, as valgrind knows no newer ones."""
    made = checker("gcc", folder, to / "counted", "-march=x86-64-v3")
    few = to / "few.bin"
    whole = (folder / "vectors.bin").read_bytes()
    few.write_bytes(whole[: len(whole) // 10])
    out = to / "callgrind.out"
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", made]
    row = told([*command, folder / "step.tables", few])
    annotate = ["callgrind_annotate", "--inclusive=yes", out]
    shown = subprocess.run(annotate, capture_output=True, text=True, check=True)
    line = next(x for x in shown.stdout.splitlines() if "run_step" in x)
    total = int(re.match(r"\s*([\d,]+)", line)[1].replace(",", ""))
    return {**row, "instructions_a_slot": total / row["slots"]}


def rooted(folder: Path, to: Path) -> dict:
    """In a root with nothing but the C library and the mathematics."""
    root, made = to / "root", checker("gcc", folder, to / "alone")
    root.mkdir()
    needed = subprocess.run(["ldd", made], capture_output=True, text=True, check=True)
    for path in re.findall(r"(/\S+)", needed.stdout):
        (root / path[1:]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, root / path[1:])
    for path in (made, folder / "step.tables", folder / "vectors.bin"):
        shutil.copy(path, root / path.name)
    row = told(["chroot", root, "/alone", "/step.tables", "/vectors.bin"])
    return {**row, "files": sorted(p.name for p in root.rglob("*") if p.is_file())}


def hostile(folder: Path, to: Path) -> dict:
    """Slots that no rig sends, with checks of addresses and undefined behaviour."""
    flags = ["-std=gnu99", "-O1", "-fsanitize=address,undefined"]
    source, made = [HERE / "hostile.c", folder / "step.c"], to / "hostile"
    command = ["gcc", *flags, "-fno-sanitize-recover=all", f"-I{folder}", *source]
    subprocess.run([*command, "-lm", "-o", made], check=True)
    command = [made, folder / "step.tables", str(HOSTILE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    fine = done.stdout == f"{HOSTILE} slots\n"
    more = {} if fine else {"failed": done.stderr[-300:]}
    return {"slots": HOSTILE, "status": done.returncode, **more}


def board(folder: Path, to: Path) -> dict:
    """A thousand vectors on a Cortex-M7 without a system: see board.c."""
    whole = (folder / "vectors.bin").read_bytes()
    (to / "few.bin").write_bytes(whole[: len(whole) // 10])
    shutil.copy(folder / "step.tables", to)
    command = ["arm-none-eabi-gcc", *FLAGS, "-fno-PIC", *M7, f"-I{folder}"]
    subprocess.run([*command, "-c", folder / "step.c", "-o", to / "step.o"], check=True)
    size = subprocess.run(
        ["arm-none-eabi-size", to / "step.o"], capture_output=True, text=True, check=True
    ).stdout.splitlines()[1]
    linked = ["--specs=rdimon.specs", "-nostartfiles", "-T", HERE / "board.ld", "-lm"]
    command = [*command, HERE / "board.c", to / "step.o", *linked, "-o", to / "board.elf"]
    subprocess.run(command, check=True, cwd=to)
    done = subprocess.run(
        [*QEMU, "-kernel", to / "board.elf"], capture_output=True, text=True, check=True
    )
    names = "slots", "differ", "instructions_a_slot", "instructions_at_most", "stack_bytes"
    row = dict(zip(names, map(int, re.findall(r"\d+", done.stdout)), strict=True))
    return {**row, "code_bytes": int(size.split()[0])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=HERE.parents[1] / "notebooks" / "results"
    )
    parser.add_argument("--shape", choices=SHAPES, action="append")
    given, rows = parser.parse_args(), []
    for name in given.shape or SHAPES:
        with tempfile.TemporaryDirectory() as place:
            to, folder = Path(place), Path(place) / "step"
            seconds = compiled(name, folder)
            made = checker("gcc", folder, to / "here", "-march=native", "-fstack-usage")
            stack = [
                x.split("\t") for p in to.glob("*.su") for x in p.read_text().splitlines()
            ]
            text = subprocess.run(
                ["size", folder / "libtomojax_step.so"], capture_output=True, text=True
            ).stdout.splitlines()[1]
            rows.append({
                "shape": name, "where": "here", "written_and_compiled_s": seconds,
                "code_bytes": int(text.split()[0]),
                "stack_bytes": max(int(s[1]) for s in stack),
                "tables_bytes": (folder / "step.tables").stat().st_size,
                **told([made, folder / "step.tables", folder / "vectors.bin"]),
            })  # fmt: skip
            if shutil.which("valgrind"):
                rows.append(
                    {"shape": name, "where": "callgrind", **instructions(folder, to)}
                )
            rows.append(
                {"shape": name, "where": "root without Python", **rooted(folder, to)}
            )
            made = checker(
                "gcc", folder, to / "checked", "-O1", "-fsanitize=address,undefined"
            )
            files = folder / "step.tables", folder / "vectors.bin"
            rows.append({"shape": name, "where": "sanitizers", **told([made, *files])})
            rows.append({"shape": name, "where": "hostile slots", **hostile(folder, to)})
            for where, (cc, emulator, flag) in ARM.items():
                if shutil.which(cc) and shutil.which(emulator):
                    made = checker(cc, folder, to / "arm", flag, "-static")
                    rows.append(
                        {"shape": name, "where": where, **told([emulator, made, *files])}
                    )
            if name == "4 x 4" and all(map(shutil.which, ("arm-none-eabi-gcc", QEMU[0]))):
                rows.append({"shape": name, "where": "Cortex-M7", **board(folder, to)})
        kept(given.out / "native_elsewhere.json", rows)
        for row in (row for row in rows if row["shape"] == name):
            print(json.dumps(row), flush=True)


def kept(path: Path, rows: list[dict]) -> None:
    """Writes rows; those of other shapes stay in the file."""
    old = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [row for row in old if row["shape"] not in {r["shape"] for r in rows}] + rows
    rows.sort(key=lambda row: SHAPES.index(row["shape"]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
