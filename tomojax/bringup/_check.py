"""Finds out what is wrong with a new rig, from one of its recordings."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool

from tomojax.bringup._amounts import (
    drive_faults,
    drive_of,
    gain_faults,
    sheet_factor,
    sheet_faults,
    SheetFactor,
)
from tomojax.bringup._channels import hum_faults, noise_faults, shorted
from tomojax.bringup._fault import Checked, Fault, Seen
from tomojax.bringup._places import joint_faults, place_faults
from tomojax.bringup._reading import Reading, Work
from tomojax.bringup._settling import common_settling, settle, settling_faults
from tomojax.bringup._wires import Corners, judge_wires
from tomojax.bringup._wiring import quality
from tomojax.bringup.sheet._slots import slots_of
from tomojax.recordings import Recording

# Grounds that gains and places need.
_GROUNDS = 2

# Rounds in which what is named is left out.
_ROUNDS = 2


def check(
    recording: Recording,
    corners: Corners | None = "auto",
    progress: Callable[[str], None] = lambda text: None,
) -> Checked:
    """Judges the rig that made a recording of nothing, of a rub and of two corners.

    The quiet stretch, the rub and the corner touches are found in the recording. The last
    two separate touches that hold still are corners. By default the first is at electrode 0
    (x and y least), the second at the end of row 0 (x least, y most). `corners` names other
    electrodes. None means that no corner was touched; then `check` cannot tell a mirrored
    or turned array. `unjudged` names missing parts.

    **Raises:** `ValueError` if the recording tells nothing: no contact, one touch alone, or
    voltages of another sensor.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rng = np.random.default_rng(0)
    >>> places = rng.uniform(0.012, 0.068, (24, 2))
    >>> volts = [tx.voltages(sensor, tx.Disc(xy, 0.004, 1.0)) for xy in places]
    >>> volts = np.stack([np.zeros((16, 16))] * 24 + volts)  # nothing, then the rub
    >>> volts = volts + 3e-4 * rng.normal(size=volts.shape)
    >>> volts[:, :, [5, 6]] = volts[:, :, [6, 5]]  # two wires
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, np.arange(16))
    >>> found = tx.bringup.check(recording, corners=None)
    >>> [(fault.kind, fault.channels) for fault in found.faults]
    [('swapped', (5, 6))]
    """
    progress("silence, order of channels")
    reading = Reading(slots_of(recording))
    progress("settling")
    settle(reading)
    progress("wires")
    lines = judge_wires(reading, corners)
    progress("what channels leave")
    _judge_silence(reading)
    work = _judge_channels(reading)
    figures = _judge_rig(reading, work)
    m, electrode = reading.plane.count, reading.order.electrode
    grounds = np.arange(m)
    judged = (lines.asked >= 0) & (lines.asked < m) & (lines.ground != -2)
    grounds[lines.asked[judged]] = lines.ground[judged]
    swing = np.median(np.abs(reading.volts), 0)[np.argsort(electrode)]
    return Checked(
        faults=tuple(reading.faults),
        unjudged=reading.unjudged,
        channels=electrode,
        grounds=grounds,
        figures={n: float(value) for n, value in figures.items() if np.isfinite(value)},
        contacts=reading.order.fits.xy,
        seen=Seen(reading.plane, swing),
    )


def _judge_silence(reading: Reading) -> None:
    slots, silent = reading.slots, reading.silent
    reading.faults += shorted(slots, reading.volts, silent)
    reading.faults += noise_faults(slots, silent, reading.usable)
    reading.faults += hum_faults(slots, silent, reading.usable)
    if np.isnan(silent.noise).any():
        reading.unjudged["zeros, noise and hum"] = (
            f"{silent.slots} contact-free slots: leave the sheet alone for some seconds"
        )
    elif not silent.seconds:
        reading.unjudged["hum"] = "the contact-free stretch is too short"


def _judge_channels(reading: Reading) -> Work:
    """Judges gains, places, tears and old slots in turn, without channels already named."""
    reading.faults += common_settling(reading.lingers, reading.lingers_error)
    work, every = reading.work(), reading.usable
    if not np.isfinite(reading.lingers_error):
        reading.unjudged["settling"] = "no slots that follow each other with other grounds"
    if len(np.unique(reading.asked)) < _GROUNDS:
        reading.unjudged["gains, places and tears"] = (
            f"fewer than {_GROUNDS} grounds: record with --pattern all"
        )
        return work
    named, now = _named(work, reading.loose), every
    for _ in range(_ROUNDS):
        left = every.copy()
        left[[f.channels[0] for f in named if f.kind != "tear"]] = False
        if (left == now).all() or left.sum() < reading.plane.count // 2:
            break
        now = reading.usable = left
        reading.again()
        reading.usable = every
        work = reading.work()
        named = _named(work, reading.loose)
    reading.faults += named
    if not any(f.kind == "tear" for f in named):
        reading.faults += joint_faults(work)
    return work


def _named(work: Work, loose: Bool[np.ndarray, " M"]) -> list[Fault]:
    """Finds faults of single channels and of the sheet."""
    slow = settling_faults(work)
    lingering = np.isin(work.channel, [f.channels[0] for f in slow])
    places, taken = place_faults(work, lingering | loose[work.channel])
    named = work.channel[taken]
    slow = [f for f in slow if f.channels[0] not in named]
    alone = [f.channels[0] for f in places if f.kind == "misplaced"]
    gains = gain_faults(work, taken & ~np.isin(work.channel, alone))
    return [*gains, *slow, *places]


def _judge_rig(reading: Reading, work: Work) -> dict[str, float]:
    """Judges the drive and the sheet's resistance; returns the measured figures."""
    rig, silent = reading.slots.rig, reading.silent
    drive, error = drive_of(work)
    torn = any(f.kind == "tear" for f in reading.faults)
    reading.faults += drive_faults(work, drive, error)
    if not np.isfinite(drive):
        reading.unjudged["drive"] = "no contact that holds still under several grounds"
    sheet = SheetFactor(why="two grounds alone have errors as large: --pattern all")
    if len(np.unique(reading.asked)) > _GROUNDS:
        sheet = sheet_factor(work, rig, silent.frequency)
    faults, why = sheet_faults(sheet, rig), sheet.why
    if faults and torn:
        # Its current goes around: what is left of the sheet seems to have more.
        faults, why = [], "the sheet is torn: mend that first"
    reading.faults += faults
    if why:
        reading.unjudged["sheet_resistance"] = why
    return {
        "drive_V": drive,
        "drive_known_V": error,
        "sheet_factor": sheet.factor,
        "sheet_factor_known": sheet.deviation,
        "noise_V": float(np.median(silent.noise)),
        "residual_percent": 100 * quality(reading.order.fits),
        "settling": reading.lingers,
        "slots_quiet": float(silent.slots),
        "slots_touched": float(reading.slots.touched.sum()),
    }
