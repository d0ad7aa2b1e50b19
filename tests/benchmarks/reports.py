"""Tries what public reports describe on the library, one input for each report.

    python tests/benchmarks/reports.py

Prints what came of each, as notebooks/measured/reports.md tells it. Inputs are our own.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

TRIALS: dict[str, Callable[[Path], str]] = {}


def trial(report: str) -> Callable:
    def named(function: Callable[[Path], str]) -> Callable[[Path], str]:
        TRIALS[report] = function
        return function

    return named


def read(path: Path) -> str:
    """What `tomojax info` says of a file."""
    code = "from tomojax.cli import main; main()"
    command = [sys.executable, "-c", code, "info", str(path)]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=path.parent)
    said = (ran.stdout + ran.stderr).replace(f"{path.parent}/", "").splitlines()
    known = "object at", "first scan", "notes:"
    told = [line.strip() for line in said if not line.strip().startswith(known)]
    return f"status {ran.returncode}: " + "; ".join(told)


def csv(folder: Path, change: Callable[[list[str]], list[str]], **how) -> str:
    import recordings

    codes, _ = recordings.touched(scans=40)
    path = recordings.write_csv(folder / "a.csv", codes, np.array([0, 63]), **how)
    lines = change(path.read_text().splitlines())
    path.write_text("\n".join(lines) + "\n")
    return read(path)


@trial("h5py/h5py#1179")
def cut_hdf5(folder: Path) -> str:
    import recordings

    path = recordings.write(folder / "a.h5", recordings.touched(scans=400)[0])
    path.write_bytes(path.read_bytes()[:-5000])
    return read(path)


@trial("SasView/sasview#344")
def semicolons(folder: Path) -> str:
    return csv(folder, lambda lines: lines, separator=";", decimal=",")


@trial("pandas-dev/pandas#26446")
def utf_16(folder: Path) -> str:
    csv(folder, lambda lines: lines)
    path = folder / "a.csv"
    path.write_bytes(path.read_text().encode("utf-16"))
    return read(path)


@trial("sparkfun/OpenLog_Artemis#51")
def rows_missing(folder: Path) -> str:
    return csv(folder, lambda lines: lines[:21] + lines[41:])


@trial("autosportlabs/RaceCapture-Pro_firmware#283")
def rows_of_another_rate(folder: Path) -> str:
    blank = "," * 65
    return csv(folder, lambda lines: [w for x in lines for w in (x, blank)][:-1])


@trial("mungewell/pico-timecode#11")
def a_time_missing(folder: Path) -> str:
    def change(lines: list[str]) -> list[str]:
        lines[31] = "," + lines[31].split(",", 1)[1]
        return lines

    return csv(folder, change)


@trial("NVlabs/FPSci#318")
def micros_wrap(folder: Path) -> str:
    import recordings

    t0 = (2**32 - 4000 + 200 * np.arange(40)) % 2**32 * 1e-6
    return read(recordings.write(folder / "a.h5", recordings.touched(scans=40)[0], t0=t0))


@trial("greiman/SdFat#29")
def zeros_within(folder: Path) -> str:
    """Readings of zero for some slots while a contact is held."""
    import recordings

    codes, _ = recordings.touched(scans=90)
    codes[40:44] = 0
    return rows(recordings.write(folder / "a.h5", codes), folder, "points")


@trial("robotology/mesh-support#3")
def pressed_at_the_start(folder: Path) -> str:
    import recordings

    codes, _ = recordings.touched(scans=90)
    held = np.concatenate([codes[40:50], codes[:30], codes[40:50]])
    return rows(recordings.write(folder / "a.h5", held), folder, "points")


def rows(path: Path, folder: Path, method: str) -> str:
    """Counts and flags of rows, and events."""
    import h5py

    import tomojax as tx
    from tomojax.events import EventFinder
    from tomojax.results import Settings

    with tx.open_recording(path) as recording:
        tx.reconstruct_recording(recording, folder / "o.h5", Settings(method=method))
    with h5py.File(folder / "o.h5") as file:
        t, count, flags = (file[k][:] for k in ("t", "contact_count", "flags"))
        xy, g = file["contact_xy"][:], file["contact_conductance"][:]
    finder = EventFinder.of_rows(0.02, 2e-4)
    events = finder.rows(t, count, xy, g, flags) + finder.finish()
    down = sum(e.kind == "touch_down" for e in events)
    runs = [f"{n}×{k}" for n, k in runs_of(count)]
    doubted = int((flags & int(tx.methods.DOUBT) > 0).sum())
    return f"contacts {' '.join(runs)}; {down} touch_down; {doubted} rows doubted"


def runs_of(values: np.ndarray) -> list[tuple[int, int]]:
    ends = np.flatnonzero(np.diff(values)) + 1
    parts = np.split(values, ends)
    return [(len(part), int(part[0])) for part in parts]


def touched(places: list, slots: str, method: str = "points", contacts: int = 4) -> str:
    from attacks import grounds_of
    from rig import Rig

    import tomojax as tx

    sensor, rig = tx.Sensor.grid(dtype=np.float32), Rig(np.random.default_rng(7))
    grounds = grounds_of(sensor, 2 if slots == "two" else 10)
    touch = [(rig.disc(p, 0.005).astype(float), 1e-4) for p in places]
    volts = rig.measure(rig.under(grounds, *touch))[None].astype(np.float32)
    model = tx.method(sensor, method)
    batch = tx.Batch(model, model.choose_lambda([]), contacts, images=False)
    found = batch(volts, grounds[None])
    n = int(found.contact_count[0])
    at = np.round(1e3 * found.contact_xy[0, :n], 1).tolist()
    doubt = bool(found.flags[0] & int(tx.methods.DOUBT))
    return f"{slots} slots: {n} at {at} mm{', doubted' if doubt else ''}"


@trial("TallKite/linnstrument-firmware#20")
def four_corners(folder: Path) -> str:
    """Four at the corners of a rectangle, and three: matrices tell a phantom fourth."""
    four = [(0.04, 0.05), (0.04, 0.11), (0.12, 0.05), (0.12, 0.11)]
    return f"{touched(four, 'ten')}; three, {touched(four[:3], 'ten')}"


@trial("lovyan03/LovyanGFX#64")
def two_in_one_row(folder: Path) -> str:
    return touched([(0.045, 0.07), (0.115, 0.07)], "two")


@trial("portapack-mayhem/mayhem-firmware#1063")
def in_a_corner(folder: Path) -> str:
    return touched([(0.011, 0.011)], "two") + "; " + touched([(0.150, 0.011)], "two")


@trial("adamreeve/npTDMS#272")
def tdms_cut_in_its_head(folder: Path) -> str:
    import recordings

    path = folder / "a.tdms"
    recordings.write_tdms(path, recordings.touched(scans=40)[0], np.array([0, 63]))
    content = path.read_bytes()
    path.write_bytes(content + content[:60])
    return read(path)


def main() -> None:
    found = {}
    for report, function in TRIALS.items():
        with tempfile.TemporaryDirectory() as folder:
            found[report] = function(Path(folder))
        print(f"{report}: {found[report]}", flush=True)
    text = json.dumps(found, indent=1, ensure_ascii=False)
    (RESULTS / "reports.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
