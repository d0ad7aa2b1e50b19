"""Defines recordings: measured scans with a description of the rig, read in stretches."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Integer

from tomojax._require import check_electrodes, LONGEST, require
from tomojax._shown import html_table, named, shown
from tomojax.recordings._clock import mended_gaps, mended_times, usual_step
from tomojax.recordings._outline import check_table, Outline

if TYPE_CHECKING:
    import tomojax.sensor

SCHEMA = "tomojax-recording"
VERSIONS = 1, 2  # 2 tells of outlines and conditions

# What no rig has: these catch millimetres for metres, millivolts for volts.
_NUMBERS = (1e-9, 1e12)
_FULL_SCALES = (0.1, 1000.0)  # of the converter, over the drive

# A disc of the paper is a quarter of a pitch, and its sheet has 1024 cells of that size. A
# sheet of 64 electrodes of a 32nd of a pitch has so many; `source` takes 2.5 GB for it.
_MOST_CELLS = 1 << 16

# The paper's rig, for forms that do not say.
PAPER = {
    "f_switch": 10e3,
    "drive_voltage": 4.5,
    "ground_resistance": 4.0,
    "sheet_resistance": 10e3,
    "electrode_diameter": 0.005,
}


class Scans(NamedTuple):
    """A stretch of a recording."""

    voltages: Float[np.ndarray, "n S M"]  # V, float32
    grounds: Integer[np.ndarray, "n S"]
    t0: Float[np.ndarray, " n"]  # of each scan's first slot, s

    def part(self, start: int, stop: int) -> "Scans":
        """Returns scans `start` to `stop`."""
        return Scans(*(a[start:stop] for a in self))


@dataclass(frozen=True)
class Rig:
    """A recording's description of the sensor and the converter; SI.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rig = tx.recordings.Rig.of(sensor, f_switch=1000.0)
    >>> rig.drive_voltage, rig.electrode_xy.shape
    (4.5, (16, 2))
    >>> rig.sensor().divisions  # the coarsest mesh that its electrodes allow
    (16, 16)
    """

    f_switch: float
    drive_voltage: float
    ground_resistance: float
    sheet_resistance: float
    electrode_diameter: float
    size: tuple[float, float]
    electrode_xy: np.ndarray
    rails: tuple[float, float]  # the lowest and highest voltage that can be read
    notes: str = ""
    resolution: float = 0.0  # of one code, V; 0 where it is not known
    outline: Outline | None = None  # of a sheet that is no flat rectangle
    conditions: np.ndarray | None = None  # (C, M) S to ground; None: an electrode each

    @property
    def condition_count(self) -> int:
        """Returns the number of ground conditions."""
        return len(self.electrode_xy if self.conditions is None else self.conditions)

    @property
    def version(self) -> int:
        """Returns the least version of a file that tells all of it."""
        return VERSIONS[self.outline is not None or self.conditions is not None]

    def tables(self) -> dict[str, np.ndarray]:
        """Returns the datasets of a file that tell of outline and ground conditions."""
        found = {} if self.outline is None else self.outline.datasets()
        if self.conditions is None:
            return found
        return found | {"conditions/to_ground": np.asarray(self.conditions, float)}

    @classmethod
    def of(
        cls,
        sensor: "tomojax.sensor.Sensor",
        f_switch: float = 10e3,
        rails: tuple[float, float] = (-np.inf, np.inf),
    ) -> "Rig":
        """Makes the rig of a homogeneous sensor, for voltages in memory."""
        numbers = {"f_switch": f_switch}
        for name in [name for name in PAPER if name not in numbers]:
            value = getattr(sensor, name)
            require(value.ndim == 0, name, "a value per element or electrode", "one value")
            numbers[name] = float(value)
        width, height = (float(side) for side in sensor.size)
        table = sensor.conditions
        return cls(
            **numbers,
            size=(width, height),
            electrode_xy=np.asarray(sensor.electrode_xy, float),
            rails=rails,
            resolution=float(sensor.resolution),
            notes="",
            outline=Outline.of(sensor),
            conditions=None if table is None else np.asarray(table, float),
        )

    def __repr__(self) -> str:
        return named(
            self,
            size=shown(np.asarray(self.size), "mm", 1e3),
            electrodes=str(len(self.electrode_xy)),
            sheet_resistance=shown(self.sheet_resistance, "Ω/sq"),
            drive_voltage=shown(self.drive_voltage, "V"),
            f_switch=shown(self.f_switch, "Hz"),
        )

    def sensor(self, dtype: Any = np.float32) -> "tomojax.sensor.Sensor":
        """Makes the sensor, on the coarsest mesh that its electrodes allow.

        **Raises:** `ValueError` for electrodes that are too small for the sheet.
        """
        from tomojax.sensor import Sensor  # needs JAX, which reading does not

        told: dict[str, Any] = {n: getattr(self, n) for n in PAPER if n != "f_switch"}
        told |= {"resolution": self.resolution, "conditions": self.conditions}
        told |= {"electrodes": self.electrode_xy, "dtype": dtype}
        if self.outline is not None:
            return Sensor.cut(self.size, **self.outline.sheet(self.size), **told)
        divisions = tuple(int(n) for n in np.maximum(_cells(self), 2))
        return Sensor(self.size, told.pop("electrodes"), divisions=divisions, **told)


class Recording(ABC):
    """Scans of a rig, in a file or in memory; a context that closes the file.

    The shape is `scans`, `slots` (a scan), `electrodes`. `gaps` (n, 2) has [scan number,
    scans lost], where numbers count lost scans too.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> volts = np.zeros((3, 2, 16))  # three scans of two slots
    >>> recording = tx.recordings.ArrayRecording(rig, volts, [0, 15])
    >>> isinstance(recording, tx.recordings.Recording)
    True
    >>> with recording as opened:
    ...     print(opened.read(0, 2).voltages.shape, f"{opened.interval:.4f} s a scan")
    (2, 2, 16) 0.0002 s a scan
    """

    path: Path
    rig: Rig
    scans: int
    slots: int
    electrodes: int
    t0: Float[np.ndarray, " scans"]  # of each scan's first slot, s
    interval: float  # from the start of a scan to the start of the next, s
    gaps: Integer[np.ndarray, "n 2"] = np.zeros((0, 2), int)
    mended: tuple[str, ...] = ()  # what the reader put right, in sentences
    retimed: np.ndarray = np.zeros(0, bool)  # (n,) scans whose time is made; or empty
    stretch: tuple[int, int] | None = None  # of a longer one: its first scan, and the end
    marks: tuple[tuple[float, str], ...] = ()  # moments that somebody marked: s, text
    host_time: np.ndarray = np.zeros((0, 2))  # s of the rig's clock, Unix s of the host
    opener: Callable[[], "Recording"] | None = None  # opens the file again; pickles

    @abstractmethod
    def read(self, start: int, stop: int) -> Scans:
        """Reads scans `start` to `stop`."""

    def __repr__(self) -> str:
        return named(self, **dict(self._in_short()))

    def _repr_html_(self) -> str:
        return html_table(self._in_short(), title=type(self).__name__)

    def _in_short(self) -> list[tuple[str, str]]:
        """Returns what is known without reading: names and texts."""
        lost = int(np.sum(self.gaps[:, 1])) if len(self.gaps) else 0
        return [
            ("path", str(self.path)),
            ("scans", f"{self.scans} of {self.slots} slots, {lost} lost"),
            ("duration", shown(float((self.scans + lost) * self.interval), "s")),
            ("rig", repr(self.rig)),
        ]

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickles an open file by its path."""
        return (self.opener, ()) if self.opener else super().__reduce_ex__(protocol)

    def close(self) -> None:  # noqa: B027 (arrays have nothing to close)
        """Closes the file; nothing is read after this."""

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def digest(self) -> str:
        """Computes the SHA-256 of the file."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def on_host(self, t: Any) -> np.ndarray:
        """Computes when something was by the host's clock, Unix s: rigs then share a clock.

        `t`: s of the rig's clock, as `t0` or a result's `t`. A recorder notes when rows
        came. The least delayed row of each ten seconds tells how far the clocks are apart;
        in between they drift evenly. The link's own delay stays.

        **Raises:** `ValueError` for a recording that does not tell.

        **Example:**

        >>> import numpy as np
        >>> import tomojax as tx
        >>> rig = tx.recordings.Rig.of(tx.Sensor.grid(4, 4, divisions=(16, 16)))
        >>> recording = tx.recordings.ArrayRecording(rig, np.zeros((3, 2, 16)), [0, 15])
        >>> recording.host_time = np.array([[0.0, 1e9 + 0.4], [1.0, 1e9 + 1.1]])
        >>> print(np.round(recording.on_host([0.5]) - 1e9, 3))
        [0.6]
        """
        rig, host = self.host_time.T
        require(len(rig), f"{self.path}: host_time", "none", "a recording of `record`")
        # Forty notes, in which clocks of 100 ppm part by a millisecond.
        part = np.floor((rig - rig[0]) / 10)
        order = np.lexsort((host - rig, part))
        first = order[np.unique(part[order], return_index=True)[1]]
        at = np.asarray(t, float)
        return at + np.interp(at, rig[first], (host - rig)[first])

    def rows_after_gaps(self) -> np.ndarray:
        """Returns rows just before which scans were lost."""
        number, lost = self.gaps.T
        return (number - np.cumsum(lost) + lost).astype(int)

    def lost_before(self) -> Integer[np.ndarray, " k"]:
        """Counts the scans lost just before each scan, and those lost behind the last."""
        lost = np.zeros(self.scans + 1, np.int64)
        rows = np.minimum(self.rows_after_gaps(), self.scans)
        np.add.at(lost, rows, self.gaps[:, 1])
        return lost


class ArrayRecording(Recording):
    """Voltages (n, S, M) in memory, of a `Rig`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> volts = np.zeros((3, 2, 16))  # three scans of two slots
    >>> recording = tx.recordings.ArrayRecording(rig, volts, [0, 15])
    >>> recording.scans, recording.slots, recording.electrodes
    (3, 2, 16)
    >>> print(recording.read(1, 3).grounds)
    [[ 0 15]
     [ 0 15]]
    """

    def __init__(self, rig: Rig, voltages: Any, grounds: Any, t0: Any = None):
        v, g = np.asarray(voltages), np.asarray(grounds)
        require(v.ndim == 3, "voltages", f"shape {v.shape}", "(scans, slots, electrodes)")
        self.path, self.rig = Path("arrays"), rig
        self.scans, self.slots, self.electrodes = v.shape
        fits = g.shape in (v.shape[:2], v.shape[1:2])
        require(fits, "grounds", f"shape {g.shape}", f"{v.shape[:2]} or {v.shape[1:2]}")
        g = np.broadcast_to(g, v.shape[:2])
        check(self)
        self.interval = self.slots / rig.f_switch
        times = np.arange(len(v)) * self.slots / rig.f_switch if t0 is None else t0
        self.t0 = np.asarray(times, float)
        self._scans = Scans(v.astype(np.float32), g.astype(int), self.t0)

    def read(self, start: int, stop: int) -> Scans:
        return self._scans.part(start, stop)

    def digest(self) -> str:
        """Computes the SHA-256 of the arrays."""
        digest = hashlib.sha256()
        for array in self._scans:
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def check(recording: Recording) -> None:
    """Checks the rules for every form. **Raises:** `ValueError` naming the field."""
    rig, m = recording.rig, recording.electrodes
    check_numbers(rig)
    size = np.asarray(rig.size)
    plausible = size.shape == (2,) and ((size > 0) & (size <= LONGEST)).all()
    require(plausible, "size", size.tolist(), f"(2,) m, no more than {LONGEST:g} m")
    shape = np.shape(rig.electrode_xy)
    require(
        shape == (m, 2), "electrode_xy", f"shape {shape}", f"({m}, 2), as v has columns"
    )
    low, high = rig.rails
    full = max(abs(low), abs(high)) / abs(rig.drive_voltage)
    fits = not np.isfinite(full) or _FULL_SCALES[0] < full < _FULL_SCALES[1]
    expected = f"volts per code: a range that fits {rig.drive_voltage:g} V of drive"
    require(low < high and fits, "scale", f"readings from {low:g} to {high:g}", expected)
    require(recording.scans > 0, "v", "no scans", "at least one")
    require(recording.slots > 0, "v", "no slots in a scan", "at least one")
    if rig.outline is None:
        check_electrodes(rig.electrode_xy, rig.size, rig.electrode_diameter)
    if rig.conditions is not None:
        check_table(rig.conditions, m)
    _cells(rig)
    gaps = recording.gaps
    fits = gaps.ndim == 2 and gaps.shape[1] == 2
    require(fits, "gaps", f"shape {gaps.shape}", "(n, 2)")
    require((gaps >= 0).all(), "gaps", "a negative number", "[scan number, scans lost]")


def check_numbers(rig: Rig) -> None:
    """Checks the rig's numbers. **Raises:** `ValueError` naming the field."""
    for name in PAPER:
        value = getattr(rig, name)
        size = abs(value) if name == "drive_voltage" else value
        low, high = _NUMBERS
        fine = low < size < high or (name == "ground_resistance" and size == 0)
        require(fine, name, repr(value), "one number above 0, in SI units")


def settle(
    recording: Recording, numbers: Integer[np.ndarray, " scans"] | None = None
) -> None:
    """Checks what a file holds, and puts its gaps and its clock right.

    `numbers` of the scans count lost scans; by default they follow from the gaps.
    **Raises:** `ValueError` naming the field.
    """
    recording.gaps, said = mended_gaps(recording.gaps, recording.scans)
    recording.mended += said
    check(recording)
    if numbers is None:
        lost = np.cumsum(recording.lost_before())[: recording.scans]
        numbers = np.arange(recording.scans) + lost
    usual = recording.slots / recording.rig.f_switch
    recording.t0, recording.retimed, said = mended_times(recording.t0, numbers, usual)
    recording.mended += said
    recording.interval = usual_step(recording.t0, usual)


def _cells(rig: Rig) -> np.ndarray:
    """Counts cells along both sides of the coarsest mesh that resolves the electrodes."""
    size, diameter = np.array(rig.size), rig.electrode_diameter
    cells = np.ceil(size / diameter * (1 - 1e-9))
    least = float(np.sqrt(size.prod() / _MOST_CELLS))
    told = f"{diameter:g} m, which takes {cells.prod():.3g} cells"
    expected = f"about {least:.2g} m or more on this sheet, for {_MOST_CELLS} cells"
    require(cells.prod() <= _MOST_CELLS, "electrode_diameter", told, expected)
    return cells
