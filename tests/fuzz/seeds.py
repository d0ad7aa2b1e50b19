"""Good files of each format that tomojax reads, small, for mutations to begin from."""

import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import recordings

KINDS = (
    "recording",
    "swmr",
    "matlab",
    "tdms",
    "results",
    "resumed",
    "calibration",
    "policy",
    "places_npz",
    "places_csv",
    "config",
)


def seed(kind: str, folder: Path) -> Path:
    """Writes a good file of that kind."""
    return _MAKE[kind](folder)


def canary_recording(path: Path, numbers: bytes) -> None:
    """Another recording of the machine: all its grounds and codes are the canary's."""
    codes = np.resize(np.frombuffer(numbers, np.uint8), (40, 2, 64)).astype(np.int16)
    grounds = np.resize(np.frombuffer(numbers, np.uint8), (40, 2))
    recordings.write(path, codes, grounds)


def _codes() -> np.ndarray:
    return recordings.noise(np.random.default_rng(0), 40)


def _recording(folder: Path) -> Path:
    path = recordings.write(folder / "seed.h5", _codes())
    with h5py.File(path, "r+") as file:
        del file["v"]
        file.create_dataset("v", data=_codes(), chunks=(8, 2, 64), compression="gzip")
    return path


def _matlab(folder: Path) -> Path:
    return recordings.write_matlab(folder / "seed.mat", _codes(), [0, 63])


def _swmr(folder: Path) -> Path:
    """As a crash leaves it: in SWMR mode, chunk after chunk."""
    live, path = folder / "live.h5", folder / "swmr.h5"
    with h5py.File(live, "w", libver="latest") as file:
        file.attrs.update(recordings.ATTRIBUTES)
        file["electrode_xy"] = recordings.electrode_xy()
        file.create_dataset("gaps", (0, 2), "i8", maxshape=(None, 2), chunks=(16, 2))
        v = file.create_dataset(
            "v", (0, 2, 64), "i2", maxshape=(None, 2, 64), chunks=(16, 2, 64), compression=1
        )
        ground = file.create_dataset(
            "ground", (0, 2), "u1", maxshape=(None, 2), chunks=(16, 2)
        )
        t0 = file.create_dataset(
            "t0", (0,), "f8", maxshape=(None,), chunks=(16,), fillvalue=np.nan
        )
        file.swmr_mode = True
        codes = np.tile(_codes(), (3, 1, 1))
        for start in range(0, len(codes), 20):
            stop = start + 20
            times = np.arange(start, stop) * 2e-4
            rows = (v, codes[start:stop]), (ground, np.tile([0, 63], (20, 1))), (t0, times)
            for dataset, new in rows:
                dataset.resize(stop, 0)
                dataset[start:] = new
                dataset.flush()
        path.write_bytes(live.read_bytes())
    return path


def _tdms(folder: Path) -> Path:
    from nptdms import ChannelObject, RootObject, TdmsWriter

    path, codes = folder / "seed.tdms", _codes().reshape(-1, 64)
    with TdmsWriter(path) as writer:
        root = RootObject({"slots_per_scan": 2, "drive_voltage": 4.5, "notes": "seed"})
        channels = [
            ChannelObject("scan", f"ai{e}", codes[:, e] * (5 / 32768)) for e in range(64)
        ]
        ground = ChannelObject("scan", "ground", np.tile(np.uint8([0, 63]), 40))
        writer.write_segment([root, *channels, ground])
    return path


def _results(folder: Path) -> Path:
    path, n = folder / "seed.results.h5", 12
    place = np.full((n, 2, 2), np.nan, "f4")
    place[2:, 0] = [0.05, 0.06]
    one = np.where(np.isfinite(place[..., 0]), 1, np.nan).astype("f4")
    with h5py.File(path, "w") as file:
        file["t"] = np.arange(n) * 2e-4
        file["contact_count"] = np.isfinite(one).sum(1).astype("u1")
        file["contact_xy"] = place
        for name, value in (
            ("radius", 0.005), ("angle", np.nan), ("current", 1e-4), ("conductance", 1e-4)
        ):  # fmt: skip
            file[f"contact_{name}"] = value * one
        file["contact_covariance"] = one[..., None] * np.float32([1e-8, 1e-8, 0])
        file["residual"] = np.zeros(n, "f4")
        file["flags"] = np.zeros(n, "u4")
        file["rung"] = np.ones(n, "u1")
        for name in file:
            file[name].attrs["unit"] = "1"
        file.attrs.update(schema="tomojax-results", schema_version=1, method="points")
        file.attrs.update(drive_voltage=4.5, sheet_resistance=1e4, size=[0.16, 0.16])
        file.attrs["electrode_xy"] = recordings.electrode_xy()
        file.attrs.update(lam=1.0, lam_relative=1e-6)
    return path


def _resumed(folder: Path) -> Path:
    """A results file as the command leaves it, to be found by one with --resume."""
    import subprocess

    path, rec = folder / "resumed.h5", _recording(folder)
    words = "--no-images", "--method", "linear", "--grid", "8"
    command = [sys.executable, "-m", "tomojax.cli", "reconstruct", rec, "-o", path, *words]
    code = "from tomojax.cli import main; main()"
    command[1:3] = ["-c", code]
    subprocess.run(command, check=True, capture_output=True)
    return path


def _calibration(folder: Path) -> Path:
    import tomojax as tx

    path, each = folder / "seed.json", (0.01,) * 64
    tx.Calibration(
        offset=each,
        gain=(1.0,) * 64,
        noise=3e-4,
        ground=each,
        electrodes=((1e-4, 0.0),) * 64,
        pressure=(1e-3, 0.5),
        deviation={"offset": each, "gain": each, "sheet": (0.01,) * 14},
        made="2026-01-31",
    ).save(path)
    return path


def _policy(folder: Path) -> Path:
    path = folder / "policy.npz"
    table = np.arange(32).reshape(4, 4, 2) % 16
    np.savez(path, table=table, idle=[0, 15], size=[0.08, 0.08], lam=np.ones((4, 4)))
    return path


def _places_npz(folder: Path) -> Path:
    path = folder / "places.npz"
    np.savez(path, xy=np.full((40, 2), 0.05))
    return path


def _places_csv(folder: Path) -> Path:
    path = folder / "places.csv"
    path.write_text("x, y\n" + "0.05, 0.06\n" * 40)
    return path


def _config(folder: Path) -> Path:
    path = folder / "order.toml"
    path.write_text("channels = [ 0, 1, 2, 3 ]\ngrounds = [ 3, 2, 1, 0 ]\nspeed = 1.0\n")
    return path


def _recording_csv(folder: Path) -> Path:
    path = recordings.write_csv(folder / "seed.csv", _codes()[:20], [0, 63])
    path.with_suffix(".toml").unlink()  # the paper's rig
    return path


def _sidecar(folder: Path) -> Path:
    _recording_csv(folder)
    path = folder / "sidecar.toml"
    path.write_text(f"{recordings.SIDECAR}slots = 2\nscale = 2.5\nrails = [ -5.0, 5.0 ]\n")
    return path


def _recording_npz(folder: Path) -> Path:
    return recordings.write_npz(folder / "seed.npz", _codes(), [0, 63])


def _recording_mcap(folder: Path) -> Path:
    return recordings.write_mcap(folder / "seed.mcap", _codes(), [0, 63])


_MAKE: dict[str, Callable[[Path], Path]] = {
    "recording": _recording,
    "swmr": _swmr,
    "matlab": _matlab,
    "tdms": _tdms,
    "results": _results,
    "resumed": _resumed,
    "calibration": _calibration,
    "policy": _policy,
    "places_npz": _places_npz,
    "places_csv": _places_csv,
    "config": _config,
    "recording_csv": _recording_csv,
    "recording_npz": _recording_npz,
    "recording_mcap": _recording_mcap,
    "sidecar": _sidecar,
}
