"""What runs on a system that has less: see `test_platforms`. Prints "ok"."""

import importlib
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import tomojax
import tomojax.hardware
import tomojax.kernels
from tomojax.cli import main as command
from tomojax.hardware import open_source, run, SlotRing
from tomojax.hardware.loop import real_time
from tomojax.hardware.loop.recorder import Recorder
from tomojax.recordings import attributes, open_recording
from tomojax.results.loading import LoadedResults

DEMO = Path(tomojax.__file__).with_name("demo.h5")


def import_all() -> None:
    """Without pyserial, which picks its modules by what the system is."""
    left_out = ("__main__", "hardware.sources.serial")
    for package in (tomojax, tomojax.kernels, tomojax.hardware):
        folder = Path(package.__file__ or "").parent
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join([package.__name__, *parts]).removesuffix(".__init__")
            if not name.endswith(left_out):
                importlib.import_module(name)


def replay_and_record(folder: Path) -> None:
    """Slots of a recording through a ring and a recorder into another recording."""
    with open_source(str(DEMO)) as source:
        ring = SlotRing.create(source.electrodes, folder=folder)
        with open_recording(DEMO) as recording:
            told = attributes(recording.rig, source.scale, source.offset)
        recorder = Recorder(ring, folder / "again.h5", told)
        taken = 0

        def enough() -> bool:
            nonlocal taken
            taken += 1
            return taken > 300

        run(source, None, ring, until=enough)
        ring.head["done"][...] = 1
        recorder.close()
        rows = int(ring.head["rows"])
        ring.remove()
    with open_recording(folder / "again.h5") as recording:
        assert recording.scans == rows > 100, (recording.scans, rows)


def reconstruct(folder: Path) -> None:
    """By the command line, whose rows go to their places in the file."""
    out = folder / "out.h5"
    words = ["reconstruct", str(DEMO), "-o", str(out), "--to", "0.2", "--method", "source"]
    for sys.argv in (["tomojax", "info", str(DEMO)], ["tomojax", *words]):
        try:
            command()
        except SystemExit as error:
            assert not error.code, error
    with LoadedResults(out) as results:
        assert results.rows == 20 and np.isfinite(results.read("t")).all()


def main() -> None:
    warnings.simplefilter("ignore")
    import_all()
    with tempfile.TemporaryDirectory() as name:
        replay_and_record(Path(name))
        reconstruct(Path(name))
        with real_time():
            pass
    print("ok")


if __name__ == "__main__":
    main()
