"""Recordings for `check` of rigs that are not ours, wired and told wrongly as asked.

A rig's exact voltages under every ground are made once (`Voltages`); wiring, chain and
header are made wrong afterwards, by a few words (`recorded`).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import h5py
import numpy as np

import tomojax as tx
from bench.rigs import draw_rig, draw_touch, Elements, Touch


def grid(rows: int, columns: int, pitch: float = 0.02, **others: Any) -> tx.Sensor:
    """Sensors of many electrodes, discs of a quarter of the pitch."""
    others = {"electrode_diameter": pitch / 4} | others
    divisions = 4 * rows, 4 * columns
    return tx.Sensor.grid(
        rows, columns, pitch, pitch / 2, divisions=divisions, dtype=np.float32, **others
    )


def symmetry(rows: int, columns: int, turned: bool, up: bool, left: bool) -> np.ndarray:
    """The electrode that each one becomes where the array is mirrored or turned."""
    index = np.arange(rows * columns).reshape(rows, columns)
    index = index.T if turned else index
    return index[:: -1 if up else 1, :: -1 if left else 1].ravel()


class Voltages(NamedTuple):
    """Exact voltages of a rig; the last four touches are in the corners."""

    rig: Any
    xy: np.ndarray  # (T, 2) m
    volts: np.ndarray  # (T, M, M), under each ground

    def under(
        self, touch: int, grounds: list[int], leaks: dict[int, float] | None = None
    ) -> np.ndarray:
        """With these grounds at once, or none: the electrodes' network as seen by them.

        `leaks`: Ω from electrodes to ground, where these are not grounded.
        """
        leaks = {e: r for e, r in (leaks or {}).items() if e not in grounds}
        grounds = [*grounds, *leaks]
        drive = float(self.rig.sensor.drive_voltage)
        if not grounds:
            return np.full(self.volts.shape[1], drive)
        if len(grounds) == 1 and not leaks:
            return self.volts[touch, grounds[0]]
        z = self.rig.ground
        v = self.volts[touch].astype(float)
        own = z * drive / np.diag(v)  # Z_ll + z_l
        table = (1 - v.T / drive) * own
        z = z.copy()
        z[list(leaks)] = list(leaks.values())
        some = np.ix_(grounds, grounds)
        current = np.linalg.solve(
            (table + table.T)[some] / 2 + np.diag(z[grounds]), np.full(len(grounds), drive)
        )
        seen = drive - table[:, grounds] @ current
        seen[grounds] = z[grounds] * current
        return seen


def voltages_of(
    sensor: tx.Sensor,
    seed: int,
    touches: int = 80,
    model: Any = Elements,
    tear: Any = None,
    misplaced: dict[int, tuple[float, float]] | None = None,
    joint: dict[int, float] | None = None,
    **words: Any,
) -> Voltages:
    """`touches` anywhere, and one in each corner: 0, columns − 1, and those opposite.

    `tear`: a function of points (n, 2) that multiplies the sheet's resistance;
    `misplaced`: of electrodes, m; `joint`: Ω between electrodes and sheet.
    """
    rng = np.random.default_rng(seed)
    rig = draw_rig(sensor, rng, **words)
    if tear is not None:
        sheet = rig.sheet
        rig = replace(rig, sheet=lambda points: sheet(points) * tear(points))
    if misplaced:
        place = rig.place.copy()
        for e, by in misplaced.items():
            place[e] += by
        rig = replace(rig, place=place)
    if joint:
        contact = rig.contact.copy()
        for e, more in joint.items():
            contact[e] += more
        rig = replace(rig, contact=contact)
    return touched(rig, rng, touches, model)


def touched(
    rig: Any, rng: np.random.Generator, touches: int, model: Any, row: str = "usual"
) -> Voltages:
    """Exact voltages of touches anywhere on a rig, and of one in each corner."""
    sensor, exact = rig.sensor, model(rig)
    m = sensor.electrode_count
    xy = np.asarray(sensor.electrode_xy, float)
    some = [draw_touch(sensor, row, rng) for _ in range(touches)]
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * (xy.max(0) - xy.min(0))
    square = float(np.mean(np.asarray(sensor.sheet_resistance)))
    for corner in xy.min(0) + corners:
        where = corner + 0.15 * sensor.mean_pitch * rng.uniform(-1, 1, 2)
        finger = draw_touch(sensor, row, rng)
        radius = 0.3 * sensor.mean_pitch
        firm = max(finger.conductance, 0.1 / square)
        some.append(Touch(where, (radius, radius), 0.0, firm))
    volts = [exact.touched(touch, np.arange(m)) for touch in some]
    return Voltages(
        rig, np.array([touch.xy for touch in some]), np.array(volts, np.float32)
    )


def recorded(
    made: Voltages,
    seed: int,
    *,
    slots: int = 1,
    hold: int = 12,
    quiet: int = 4000,
    pattern: Any = None,
    corners: Any = (0, 1),
    f_switch: float = 10e3,
    channels: Any = None,
    lines: Any = None,
    on: int | None = None,
    leaks: dict[int, float] | None = None,
    dead: Any = (),
    stuck: dict[int, float] | None = None,
    gain: dict[int, float] | None = None,
    noise: dict[int, float] | None = None,
    settling: Any = 0.0,
    hum: float = 0.0,
    hum_frequency: float = 50.0,
    told: dict[str, float] | None = None,
    rub: Any = None,
    whole: bool = True,
) -> tx.recordings.ArrayRecording:
    """A recording of nothing, a rub and two corners, as a rig with these faults leaves it.

    `channels`: the electrode that each channel reads; `lines`: the electrode that each
    ground line switches, −1: none; `on`: a line that is always on; `leaks`: Ω from
    electrodes to ground; `told`: what the header says, as factors; `settling`: the part of
    the slot before, of all or of each.
    """
    rng = np.random.default_rng(seed)
    m, rig = made.volts.shape[1], made.rig
    wired = np.arange(m) if channels is None else np.asarray(channels)
    lines = np.arange(m) if lines is None else np.asarray(lines)
    pattern = np.arange(m) if pattern is None else np.asarray(pattern)
    hold = -(-hold // slots) * slots if slots > 1 else hold
    calm = -(-quiet // slots) * slots
    short = -(-max(quiet // 8, 40) // slots) * slots
    touches = [-1] * calm if quiet else []
    for t in range(len(made.volts) - 4) if rub is None else rub:
        touches += [t] * hold
    for c in corners:
        touches += [-1] * short + [len(made.volts) - 4 + c] * (6 * hold)
    touches += [-1] * short if len(corners) else []
    asked = np.resize(pattern, len(touches))
    exact = np.zeros((len(touches), m))
    for s, (t, g) in enumerate(zip(touches, asked)):
        if t < 0:
            continue
        grounded = [int(lines[g])] if lines[g] >= 0 else []
        grounded += [on] if on is not None and on not in grounded else []
        exact[s] = made.under(t, grounded, leaks)
    exact = exact[:, wired]
    part = np.broadcast_to(np.asarray(settling, float), m)
    before = np.concatenate([exact[:1], exact[:-1]])
    exact = (1 - part) * exact + part * before
    chain = replace(rig.chain, hum=hum, hum_frequency=hum_frequency / f_switch)
    factors = chain.gain.copy()
    for c, by in (gain or {}).items():
        factors[c] *= by
    read = replace(chain, gain=factors).read(exact, rng)
    for c, rms in (noise or {}).items():
        read[:, c] += rms * rng.normal(size=len(read))
    code = chain.full_scale / 2 ** (chain.bits - 1)
    for c in dead:
        read[:, c] = chain.noise * rng.normal(size=len(read)) if whole else 0.0
    for c, value in (stuck or {}).items():
        read[:, c] = value
    read = code * np.round(read / code)
    about = tx.recordings.Rig.of(
        rig.sensor, f_switch, (-chain.full_scale, chain.full_scale)
    )
    about = replace(about, resolution=code)
    for name, factor in (told or {}).items():
        about = replace(about, **{name: getattr(about, name) * factor})
    n = len(read) // slots
    shape = n, slots
    return tx.recordings.ArrayRecording(
        about, read[: n * slots].reshape(*shape, m), asked[: n * slots].reshape(shape)
    )


def write(path: Any, recording: tx.recordings.ArrayRecording) -> Any:
    """The recording as a file, version 1."""
    rig, scans = recording.rig, recording.read(0, recording.scans)
    scale = rig.resolution
    with h5py.File(path, "w") as file:
        codes = np.clip(np.round(scans.voltages / scale), -32768, 32767)
        file.create_dataset("v", data=codes.astype(np.int16), compression="gzip")
        file["ground"] = scans.grounds.astype(np.uint8)
        file["t0"] = scans.t0
        file["gaps"] = np.zeros((0, 2), np.int64)
        file["electrode_xy"] = np.asarray(rig.electrode_xy, float)
        names = "f_switch", "drive_voltage", "ground_resistance", "sheet_resistance"
        file.attrs.update({name: getattr(rig, name) for name in names})
        file.attrs.update(
            schema="tomojax-recording",
            schema_version=1,
            scale=scale,
            offset=0.0,
            size=list(rig.size),
            electrode_diameter=rig.electrode_diameter,
            settle_delay=2e-5,
            convert_period=1e-6,
            units="V",
            notes="",
        )
    return path
