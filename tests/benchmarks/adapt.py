"""Measures place errors hour by hour through a day of drift, with and without --adapt.

    python tests/benchmarks/adapt.py [--seed N] [--hours 24]

Four rigs come from two models: a resistor network and finite elements
(`bench.rigs`). Each model makes the paper's sensor, and one of 6 × 6 electrodes
on 300 mm and 30 kΩ/sq. Each rig is calibrated from 120 contacts at unknown places. Every 30
s of the day has two scans of silence and one of a contact. There are 200 contacts, which
come again in any order. The day includes two hours of silence, and an hour in which one
contact is held still.

Gains drift by 1 % an hour and zeros by 1 mV an hour (of a drive of 4.5 V). In "steady"
drift, each channel goes up or down all day long. In "wandering" drift, rates turn within
hours. The same day without drift tells the start's error. The default seeds are for
judging: nothing was set on them. Writes adapt.json and adapt.png.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

EVERY, SILENT, HELD, NIGHT = 30.0, 2, 12, (3, 4)
CALIBRATED, TOUCHES = 120, 200
CASES = (
    ("network", "8 × 8, 160 mm", "steady"),
    ("elements", "8 × 8, 160 mm", "wandering"),
    ("network", "6 × 6, 300 mm", "wandering"),
    ("elements", "6 × 6, 300 mm", "steady"),
)
RUNS = {"start": "no drift", "without": "drift", "adapt": "drift, --adapt"}


def sensor_of(name: str) -> Any:
    import tomojax as tx

    if name.startswith("8"):
        return tx.Sensor.grid(dtype=np.float32)
    return tx.Sensor.grid(
        6,
        6,
        pitch=0.05,
        margin=0.025,
        electrode_diameter=0.0125,
        sheet_resistance=30e3,
        divisions=(36, 36),
        dtype=np.float32,
    )


def grounds_of(m: int) -> np.ndarray:
    """Ten grounds all over the sheet, two corners first."""
    return np.array([0, m - 1, *np.linspace(1, m - 2, 8).round().astype(int)])


def drawn(case: tuple[str, str, str], seed: int) -> dict[str, Any]:
    """A rig, its calibration, and voltages and places of contacts on it."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch, Elements, network_of

    rng = np.random.default_rng([seed, CASES.index(case)])
    sensor = sensor_of(case[1])
    rig = draw_rig(sensor, rng)
    exact = (network_of if case[0] == "network" else Elements)(rig)
    grounds = grounds_of(sensor.electrode_count)
    volts, places = [], []
    for _ in range(CALIBRATED + TOUCHES):
        touch = draw_touch(sensor, "usual", rng)
        volts.append(exact.touched(touch, grounds))
        places.append(touch.centre)
    volts, places = np.array(volts), np.array(places)
    rub = rig.chain.read(volts[:CALIBRATED], rng)
    quiet = rig.chain.read(np.zeros((100, *volts.shape[1:])), rng)
    told = tx.recordings.Rig.of(sensor)
    before = tx.calibration.tare(tx.recordings.ArrayRecording(told, quiet, grounds))
    under = np.tile(grounds, (CALIBRATED, 1))
    known = tx.calibration.calibrate(sensor, rub, under, None, before)
    found = {"rig": rig, "known": known, "grounds": grounds, "rng": rng}
    return found | {"volts": volts[CALIBRATED:], "places": places[CALIBRATED:]}


def drift_of(kind: str, times: np.ndarray, m: int, rng) -> np.ndarray:
    """Of values of 1 an hour, (n, M)."""
    hours = times[:, None] / 3600
    if kind == "steady":
        return hours * rng.choice([-1.0, 1.0], m)
    # Six waves of 6 to 48 hours with any phase, whose rate is 1 an hour rms.
    found = np.zeros((len(times), m))
    for turn in 2 * np.pi / np.geomspace(6, 48, 6):
        phase = rng.uniform(0, 2 * np.pi, m)
        wave = np.sin(turn * hours + phase) - np.sin(phase)
        found += wave * np.sqrt(2 / 6) / turn
    return found


def day_of(case, rig: dict[str, Any], hours: int) -> dict[str, np.ndarray]:
    """Readings of a day without drift and with it, and what touched when."""
    rng, m = rig["rng"], rig["volts"].shape[-1]
    chain = rig["rig"].chain
    turns = np.arange(round(hours * 3600 / EVERY))
    hour = (turns * EVERY / 3600).astype(int)
    which = rng.integers(1, TOUCHES, len(turns))
    held, night = hour == HELD, np.isin(hour, NIGHT)
    which[held], which[night] = 0, -1
    scans = np.full((len(turns), SILENT + 1), -1)
    scans[:, -1] = which
    scans[held] = 0
    exact = np.where((scans >= 0)[..., None, None], rig["volts"][scans], 0)
    exact = exact.reshape(-1, *exact.shape[2:])
    t = (EVERY * turns[:, None] + 1e-3 * np.arange(SILENT + 1)).ravel()
    gain = 0.01 * drift_of(case[2], t, m, rng)
    zero = 1e-3 * drift_of(case[2], t, m, rng)
    noise = chain.noise * rng.normal(size=exact.shape)
    step = chain.full_scale / 2 ** (chain.bits - 1)

    def read(gain: np.ndarray | float, zero: np.ndarray | float) -> np.ndarray:
        v = exact * chain.gain * np.exp(gain) + chain.zero + zero + noise
        return (np.round(v / step) * step).astype(np.float32)

    start, drifted = read(0.0, 0.0), read(gain[:, None], zero[:, None])
    found = {"t": t, "which": scans.ravel(), "gain": gain, "zero": zero}
    return found | {"start": start, "drifted": drifted}


def judged(case, seed: int, hours: int) -> dict[str, Any]:
    """Place errors of a day, hour by hour, and the errors of zeros and gains."""
    import tomojax as tx

    began = time.perf_counter()
    rig = drawn(case, seed)
    day = day_of(case, rig, hours)
    sensor = rig["rig"].sensor
    told = tx.recordings.Rig.of(sensor)
    at = day["which"]
    row: dict[str, Any] = {"model": case[0], "sensor": case[1], "drift": case[2]}
    row["seed"] = seed
    with tempfile.TemporaryDirectory() as folder:
        known = Path(folder) / "rig.json"
        rig["known"].save(known)
        for run in RUNS:
            read = day["start" if run == "start" else "drifted"]
            record = tx.recordings.ArrayRecording(told, read, rig["grounds"], day["t"])
            settings = tx.results.Settings(
                method="points",
                images=False,
                contacts=2,
                calibration=str(known),
                tare=False,
                chunk=30 * (SILENT + 1),
                adapt=run == "adapt",
            )
            out = Path(folder) / f"{run}.h5"
            tx.reconstruct_recording(record, out, settings)
            with h5py.File(out) as file:
                row[run] = hourly(file, day, rig["places"], hours)
                if run == "adapt":
                    row["left"] = left(file, day, rig)
    row["pitch_mm"] = 1e3 * float(sensor.mean_pitch)
    row["seconds"] = time.perf_counter() - began
    row["ratio"] = row["adapt"]["median_mm"] / row["start"]["median_mm"]
    hourly_ = [np.array(row[r]["hours_mm"], float) for r in ("adapt", "start")]
    busy = [h for h in range(hours) if h not in (*NIGHT, HELD)]
    row["worst_hour"] = float(np.max((hourly_[0] / hourly_[1])[busy]))
    print(json.dumps({k: v for k, v in row.items() if not isinstance(v, dict)}))
    return row | {"electrodes": int(at.size and day["gain"].shape[1])}


def hourly(file: Any, day: dict, places: np.ndarray, hours: int) -> dict[str, Any]:
    at, count = day["which"], file["contact_count"][...]
    off = np.hypot(*(file["contact_xy"][:, 0] - places[at]).T)
    off = np.where((count > 0) & (at >= 0), off, np.inf)
    hour = (day["t"] / 3600).astype(int)
    moving, held = (at > 0), (at == 0)
    parts = [off[(hour == h) & (at >= 0)] for h in range(hours)]
    return {
        "hours_mm": [1e3 * float(np.median(a)) if len(a) else None for a in parts],
        "median_mm": 1e3 * float(np.median(off[moving])),
        "p90_mm": 1e3 * float(np.quantile(off[moving], 0.9)),
        "count_right": float((count == (at >= 0)).mean()),
        "held_mm": 1e3 * float(np.median(off[held])),
        "held_seen": float((count[held] == 1).mean()),
        "held_mm_each": (1e3 * off[held]).round(4).tolist(),
    }


def left(file: Any, day: dict, rig: dict) -> dict[str, Any]:
    """What is left of the drift at the end of each chunk, rms over the channels."""
    t = file["adapted_t"][...]
    at = np.searchsorted(day["t"], t)
    gain = np.log(file["adapted_gain"][...] / np.asarray(rig["known"].gain))
    zero = file["adapted_zero"][...] - np.asarray(rig["known"].offset)
    gains = {"gain": gain - day["gain"][at], "gain_drift": day["gain"][at]}
    zeros = {"zero": zero - day["zero"][at], "zero_drift": day["zero"][at]}
    # What all gains have in common makes no voltage differ.
    found = {f"{n}_percent": 100 * a.std(1) for n, a in gains.items()}
    found |= {f"{n}_mV": 1e3 * np.sqrt((a**2).mean(1)) for n, a in zeros.items()}
    return {"t_h": (t / 3600).tolist()} | {n: a.tolist() for n, a in found.items()}


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Place errors over the day; below, what is left of the drift."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    from tomojax._pictures import GREY, plain, style

    looks = {
        "start": {"color": GREY, "marker": "."},
        "without": style(1),
        "adapt": style(0),
    }
    figure, axes = plt.subplots(
        2, len(rows), figsize=(4 * len(rows), 6.6), layout="constrained", squeeze=False
    )
    for row, (above, below) in zip(rows, axes.T):
        for run, label in RUNS.items():
            each = np.array(row[run]["hours_mm"], float)
            x = np.arange(len(each)) + 0.5
            above.plot(x, each, **looks[run], label=label)
        above.axvspan(HELD, HELD + 1, color="0.9", lw=0, label="a contact held still")
        below.axvspan(HELD, HELD + 1, color="0.9", lw=0)
        title = f"{row['model'].capitalize()}, {row['sensor']}\n{row['drift']} drift"
        above.set(yscale="log", title=title)
        told = row["left"]
        parts = (("gain", "percent", "gains, %", 2), ("zero", "mV", "zeros, mV", 3))
        for name, unit, label, k in parts:
            look = {"color": style(k)["color"], "lw": 1.2}
            drift, left = told[f"{name}_drift_{unit}"], told[f"{name}_{unit}"]
            below.plot(told["t_h"], drift, ":", **look, label=f"drift of {label}")
            line = "-" if name == "gain" else "--"
            below.plot(told["t_h"], left, line, **look, label=f"left of {label}")
        below.set(yscale="log", xlabel="time, hours", ylim=(5e-3, 100))
        for panel in (above, below):
            panel.set(xlim=(0, len(row["start"]["hours_mm"])))
            panel.grid(alpha=0.3)
            plain(panel.yaxis)
    axes[0, 0].set(ylabel="place error, mm (median)")
    axes[1, 0].set(ylabel="rms of the channels")
    for line in axes[:, -1]:
        line.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False, fontsize=9)
    figure.suptitle("A day of drift, with and without --adapt (hours 3 to 5: no contact)")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1000031)
    parser.add_argument("--hours", type=int, default=24)
    parser.add_argument("--cases", type=int, nargs="*", default=range(len(CASES)))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = [judged(CASES[k], options.seed, options.hours) for k in options.cases]
    from benchmarks.physics import environment

    report = {"environment": environment(), "rows": rows}
    (options.out / "adapt.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "adapt.png")


if __name__ == "__main__":
    main()
