"""Makes the recordings of `tomojax demo` anew.

    python tests/benchmarks/demo.py FOLDER [SCENE …]

A resistor network makes the voltages, on a rig with an uneven sheet, displaced electrodes,
gains, zeros and noise. No method is told of them. A sheet of another outline is simulated
by finite elements, on a finer mesh than the methods', with the same faults. The truth lies
beside the voltages: `truth_touched` (scans, P, P) is 1 where the sheet is touched.
`truth_xy` (scans, K, 2), m, holds the middle of each finger that touches, NaN elsewhere.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from bench.rigs import draw_rig, draw_strokes, network_of, Rig, Strokes
from tomojax.cli.demo import SCENES
from tomojax.recordings import Rig as RecordingRig
from tomojax.sensor import Sensor, voltages

_SIDE = 0.16  # m, of the paper's sheet
_TRUTH = 64  # pixels of a side
_CORNERS = (0, 63, 56)
_TEN = (0, 7, 56, 63, 3, 24, 31, 60, 27, 36)  # corners, sides and middle
_BITS = 5 / 32768  # V of a code

# A scene at each scan: what touches (None: nothing), and the fingers' middles, m.
Moment = tuple[Strokes | None, list[tuple[float, float]]]


def _fingers() -> Iterator[Moment]:
    """A finger draws an eight in two seconds and lifts once; another taps aside."""
    tapped = (0.028, 0.138)
    for k in range(200):
        t, turn = k / 200, 2 * np.pi * k / 200
        drawn = (0.085 + 0.045 * np.sin(turn), 0.075 + 0.035 * np.sin(2 * turn))
        fingers = []
        if not 0.47 < t < 0.53:
            fingers.append((drawn, 0.014, 0.3 * (1 + 0.8 * np.sin(3 * turn))))
        if np.sin(8 * turn) > 0.3:
            fingers.append((tapped, 0.012, 0.5))
        if not fingers:
            yield None, []
            continue
        places, widths, presses = zip(*fingers)
        lines = tuple(np.array([place]) for place in places)
        top = max(presses)
        yield Strokes(lines, widths, top, tuple(p / top for p in presses)), list(places)


def _letters() -> Iterator[Moment]:
    """Each letter is pressed for a tenth of a second: lightly, hard, lightly."""
    middle = np.array([_SIDE / 2, _SIDE / 2])
    for number, name in enumerate("TACT"):
        turn = (-0.15, 0.1, -0.1, 0.2)[number]
        for k in range(12):
            if k in (0, 11):
                yield None, []
                continue
            press = 0.3 * np.sin(np.pi * k / 11) ** 2
            yield draw_strokes(name, middle, 0.115, turn, press, 0.014), []


def _spanner() -> Iterator[Moment]:
    """The head lands, the ring lands, both bounce; after 36 ms the spanner lies still."""
    middle = np.array([0.08, 0.08])
    for k in range(48):
        t = k / 48  # of 48 ms
        fading = max(0.0, 1 - t / 0.75)
        rocking = np.sin(2 * np.pi * 5 * t**0.8)
        head = max(0.0, rocking) * (fading > 0) if fading else 1.0
        ring = max(0.0, -rocking) * (fading > 0) if fading else 1.0
        handle = 0.0 if fading > 0.3 else 1 - fading / 0.3
        lying = draw_strokes("spanner", middle, 0.13, 0.8 - 0.15 * (1 - fading), 5.0)
        presses = (handle, head, ring)
        if max(presses) < 0.02:
            yield None, []
            continue
        top = max(presses)
        shares = tuple(p / top for p in presses)
        yield replace(lying, per_area=5.0 * top, presses=shares), []


def _palm() -> Iterator[Moment]:
    """Five fingers touch one after another, then the palm comes down and lifts."""
    middle = np.array([0.08, 0.076])
    hand = draw_strokes("hand", middle, 0.125, 0.15, 0.8)
    for k in range(36):
        t = k / 36
        down = np.clip((t - 0.08 * np.arange(5)) / 0.15, 0, 1)
        palm = np.clip((t - 0.45) / 0.15, 0, 1)
        lifted = np.clip((0.98 - t) / 0.1, 0, 1)
        presses = lifted * np.array([palm, *down])
        if presses.max() < 0.02:
            yield None, []
            continue
        shares = tuple((presses / presses.max()).tolist())
        yield replace(hand, per_area=0.8 * float(presses.max()), presses=shares), []


def _round() -> Iterator[Moment]:
    """A finger goes round once near the rim; another presses the middle twice."""
    for k in range(100):
        turn = 2 * np.pi * k / 100
        fingers = []
        if 4 < k < 96:
            drawn = (0.08 + 0.052 * np.cos(turn), 0.08 + 0.052 * np.sin(turn))
            fingers.append((drawn, 0.014, 0.3 * (1 + 0.5 * np.sin(5 * turn))))
        if np.sin(2 * turn) > 0.2:
            fingers.append(((0.074, 0.083), 0.012, 0.5))
        if not fingers:
            yield None, []
            continue
        places, widths, presses = zip(*fingers)
        lines = tuple(np.array([place]) for place in places)
        top = max(presses)
        yield Strokes(lines, widths, top, tuple(p / top for p in presses)), list(places)


def _glove() -> Iterator[Moment]:
    """A stick is gripped, turns in the hand between the holes, and is let go."""
    for k in range(40):
        press = 0.4 * np.sin(np.pi * k / 39) ** 0.5
        if k in (0, 1, 38, 39):
            yield None, []
            continue
        angle, middle = 0.15 + 0.9 * k / 39, np.array([0.05, 0.052])
        half = 0.032 * np.array([np.cos(angle), np.sin(angle)])
        yield Strokes((np.array([middle - half, middle + half]),), (0.011,), press), []


# A palm with the thumb's side to the left, and holes for two straps, m.
_PALM = [
    [0.018, 0], [0.076, 0], [0.094, 0.03], [0.1, 0.078], [0.078, 0.106], [0.052, 0.11],
    [0.026, 0.104], [0.018, 0.082], [0, 0.066], [0.003, 0.036],
]  # fmt: skip
_HOLES = [
    [[0.03, 0.074], [0.046, 0.078], [0.046, 0.088], [0.03, 0.084]],
    [[0.064, 0.018], [0.08, 0.022], [0.076, 0.034], [0.062, 0.03]],
]

_SENSORS = {
    "round": lambda: Sensor.disc(_SIDE, {"rim": 24, "grid": 0.025}),
    "glove": lambda: Sensor.polygon(_PALM, {"rim": 18, "grid": 0.018}, _HOLES),
}


def _cut(rig: Rig) -> Callable:
    """Returns voltages of strokes on a rig's sheet, by finer finite elements."""
    sensor = rig.sensor
    nx, ny = (round(1.3 * n) for n in sensor.divisions)
    cells = (np.indices((nx, ny)).reshape(2, -1).T + 0.5) / (nx, ny)
    ohms = np.repeat(rig.sheet(cells * np.asarray(sensor.size)), 2)
    moved = replace(sensor, electrode_xy=rig.place, ground_resistance=rig.ground)
    fine = moved.on_mesh((nx, ny), ohms)
    area = np.asarray(sensor.size).prod() / (nx * ny)

    def touched(strokes: Strokes, grounds: np.ndarray) -> np.ndarray:
        part = (np.arange(4) + 0.5) / 4
        inside = np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2)
        points = (cells[:, None] - (0.5 - inside) / (nx, ny)) * np.asarray(sensor.size)
        dense = strokes.density(points.reshape(-1, 2)).reshape(len(cells), -1).mean(1)
        on = np.repeat(dense * area / 2, 2) * np.asarray(fine.parts())
        return np.asarray(voltages(fine, on, grounds))

    return touched


# Each scene's moments, grounds, time from scan to scan (s) and the rig's seed.
_MADE = {
    "fingers": (_fingers, _CORNERS, 0.01, 11),
    "letters": (_letters, _TEN, 0.01, 12),
    "spanner": (_spanner, _TEN, 0.001, 13),
    "palm": (_palm, _TEN, 0.01, 14),
    "round": (_round, (24, 30, 36, 42), 0.01, 15),
    "glove": (_glove, (18, 22, 26, 30, 34, 20), 0.01, 16),
}


def write(name: str, path: Path) -> None:
    """Writes one scene as a recording, with its truth."""
    scene, grounds, period, seed = _MADE[name]
    rng, sensor = np.random.default_rng(seed), _SENSORS.get(name, Sensor.grid)()
    rig = draw_rig(sensor, rng)
    exact = _cut(rig) if name in _SENSORS else network_of(rig).touched
    part = (np.arange(_TRUTH) + 0.5) / _TRUTH
    points = np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2)
    points = points * np.asarray(sensor.size, float)
    known = RecordingRig.of(sensor)
    drive = float(sensor.drive_voltage)
    volts, touched, places = [], [], []
    for strokes, middles in scene():
        still = np.full((len(grounds), sensor.electrode_count), drive)
        under = exact(strokes, np.array(grounds)) if strokes else still * 0
        volts.append(under)
        inside = strokes.density(points) > 0 if strokes else np.zeros(len(points), bool)
        inside = inside & np.asarray(sensor.on_sheet(points))
        touched.append(inside.reshape(_TRUTH, _TRUTH))
        places.append([*middles, *[(np.nan, np.nan)] * (2 - len(middles))])
    codes = np.round(rig.chain.read(np.stack(volts), rng) / _BITS).astype(np.int16)
    with h5py.File(path, "w") as file:
        packed = {"compression": "gzip", "compression_opts": 9, "shuffle": True}
        file.create_dataset("v", data=codes, **packed)
        file["ground"] = np.broadcast_to(np.uint8(grounds), codes.shape[:2])
        file["t0"] = np.arange(len(codes)) * period
        file["gaps"] = np.zeros((0, 2), np.int64)
        file["electrode_xy"] = np.round(np.asarray(sensor.electrode_xy, float), 6)
        file.create_dataset("truth_touched", data=np.uint8(touched), **packed)
        file.create_dataset("truth_xy", data=np.float32(places), **packed)
        for table, rows in known.tables().items():
            file[table] = rows
        file.attrs.update(
            **({} if known.outline is None else known.outline.attributes()),
            schema="tomojax-recording",
            schema_version=known.version,
            f_switch=10e3,
            scale=_BITS,
            offset=0.0,
            drive_voltage=drive,
            ground_resistance=float(np.mean(np.asarray(sensor.ground_resistance))),
            sheet_resistance=10e3,
            size=list(known.size),
            electrode_diameter=0.005,
            settle_delay=2e-5,
            convert_period=1e-6,
            units="V",
            notes=f"{SCENES[name].words} (simulated)",
        )


if __name__ == "__main__":
    for one in sys.argv[2:] or SCENES:
        write(one, Path(sys.argv[1]) / SCENES[one].file)
