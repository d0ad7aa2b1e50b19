"""Reads and writes recordings of pairs: recording version 2, kind "conductivity"."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require, require_kind
from tomojax._shown import named
from tomojax.ert.recorded._fields import (
    electrodes_of,
    fields_of,
    flag,
    NUMBERS,
    readings_of,
    text,
)
from tomojax.ert.recorded._pairs import Pairs
from tomojax.ert.recorded._reference import reference_of
from tomojax.ert.recorded._saving import save_as
from tomojax.recordings import number, Outline, SCHEMA, size_of, VERSIONS

if TYPE_CHECKING:
    import tomojax.sensor

KIND = "conductivity"


@dataclass(frozen=True, eq=False, repr=False)
class PairRecording:
    """Voltages of pairs of electrodes on a skin whose sheet changes under a press.

    **Arguments:**

    - `voltages` (n, C, R): a frame's readings, in `units`; NaN where a reading is bad.
    - `pairs`: the electrodes of each condition and reading.
    - `electrode_xy` (M, 2), `electrode_diameter`: m.
    - `outline`: where the sheet ends, an `Outline`; by default a rectangle of `size`, m.
    - `size`: of the box from which places count. Without one the middle of a disc is at
      (0, 0), and a polygon's corners are where they are told.
    - `t0` (n,): start of each frame, s; by default of frames that follow each other.
    - `places` (n, 2): where somebody pressed, m; NaN or None where unknown.
    - `f_switch`: conditions a second, Hz.
    - `units`, `notes`: texts. `magnitude`: whether voltages have lost their sign, or are
      changes of the magnitude; by default where `units` has that word.

    **Raises:** `ValueError` for shapes that disagree, and electrodes that are not there.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    >>> rim = 0.054 * np.stack([np.cos(angle), np.sin(angle)], 1)
    >>> disc = tx.recordings.Outline("disc", 0.108)
    >>> volts = np.zeros((5, 16, 12))  # five frames
    >>> pairs = tx.ert.Pairs.opposite(16)
    >>> recording = tx.ert.PairRecording(volts, pairs, rim, 0.004, outline=disc)
    >>> recording.save("skin.h5")
    >>> tx.ert.load("skin.h5").voltages.shape
    (5, 16, 12)
    """

    voltages: Float[np.ndarray, "n C R"]
    pairs: Pairs
    electrode_xy: Float[np.ndarray, "M 2"]
    electrode_diameter: float
    outline: Outline = Outline("rectangle")
    size: tuple[float, float] | None = None
    t0: Any = None
    places: Float[np.ndarray, "n 2"] | None = None
    f_switch: float = 1000.0
    units: str = "V"
    notes: str = ""
    magnitude: bool | None = None
    path: Path = Path("arrays")

    def __post_init__(self):
        require_kind("pairs", self.pairs, Pairs)
        require_kind("outline", self.outline, Outline)
        require(isinstance(self.units, str), "units", repr(self.units), "a text")
        volts, xy = np.array(self.voltages, float), np.asarray(self.electrode_xy, float)
        volts[~np.isfinite(volts)] = np.nan
        shape = self.pairs.read.shape[:2]
        fits = volts.ndim == 3 and len(volts) > 0 and volts.shape[1:] == shape
        require(fits, "v", f"shape {volts.shape}", f"(frames, {shape[0]}, {shape[1]})")
        fits = xy.ndim == 2 and xy.shape[1] == 2 and bool(np.isfinite(xy).all())
        require(fits, "electrode_xy", f"shape {xy.shape}", "(electrodes, 2) m, numbers")
        self.pairs.within(len(xy))
        for name in ("electrode_diameter", "f_switch"):
            value = getattr(self, name)
            require(0 < value < np.inf, name, value, "a number above 0")
        told = self.size is not None or self.outline.kind != "rectangle"
        require(told, "size", "none", "the rectangle's, m")
        n = len(volts)
        times = np.arange(n) * shape[0] / self.f_switch if self.t0 is None else self.t0
        put: dict[str, Any] = {"voltages": volts, "electrode_xy": xy}
        for name, value, wanted in (("t0", times, (n,)), ("places", self.places, (n, 2))):
            if value is not None:
                put[name] = found = np.asarray(value, float)
                told = f"shape {found.shape}"
                require(found.shape == wanted, name, told, f"{wanted}, as v has frames")
        if self.magnitude is None:
            put["magnitude"] = "magnitude" in self.units
        for name, value in put.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.voltages.shape))
        return named(self, path=str(self.path), voltages=shape, units=self.units)

    @property
    def bad(self) -> Bool[np.ndarray, "n C R"]:
        """Tells which readings are no numbers."""
        return ~np.isfinite(self.voltages)

    @property
    def known(self) -> Bool[np.ndarray, " n"]:
        """Tells of which frames the place is known."""
        if self.places is None:
            return np.zeros(len(self.voltages), bool)
        return np.isfinite(self.places.sum(1))

    def knowing(self, count: int) -> "PairRecording":
        """Returns the recording with the first `count` of its places alone."""
        rank = np.cumsum(self.known)
        least = int(rank[-1])
        require(0 <= count <= least, "places", f"{count}", f"0 to {least}, as it has")
        if self.places is None:
            return self
        return replace(self, places=np.where((rank > count)[:, None], np.nan, self.places))

    @property
    def origin(self) -> Float[np.ndarray, "2"]:
        """Returns where the sensor's box begins in the recording's places, m."""
        return self._ends()[0]

    @property
    def box(self) -> tuple[float, float]:
        """Returns the sides of the sensor's box, m."""
        width, height = np.ptp(self._ends(), 0)
        return float(width), float(height)

    def _ends(self) -> Float[np.ndarray, "n 2"]:
        """Returns the box's lowest and highest corner, m."""
        if self.size is not None:
            return np.array([(0.0, 0.0), self.size])
        if self.outline.loops:
            return np.stack([self.outline.loops[0].min(0), self.outline.loops[0].max(0)])
        return self.outline.diameter * np.array([[-0.5, -0.5], [0.5, 0.5]])

    def sensor(
        self, dtype: Any = np.float32, wider: float = 0.0
    ) -> "tomojax.sensor.Sensor":
        """Makes the sensor, whose places are the recording's less `origin`.

        The sheet has the nominal resistance of `Sensor`. `wider`: the outline grows about
        its box's middle by this share; electrodes and holes stay where they are. The box
        then begins `wider`/2 of its sides before `origin`.
        """
        from tomojax.sensor import Sensor  # needs JAX, which reading does not

        grown = 1 + wider
        start = self.origin - wider / 2 * np.array(self.box)
        loops = [loop - start for loop in self.outline.loops]
        loops[:1] = [grown * (loop - self.origin) for loop in self.outline.loops[:1]]
        across = grown * self.outline.diameter
        outline = replace(self.outline, loops=tuple(loops), diameter=across)
        width, height = self.box
        box = grown * width, grown * height
        return Sensor.cut(
            box,
            electrodes=self.electrode_xy - start,
            electrode_diameter=self.electrode_diameter,
            dtype=dtype,
            **outline.sheet(box),
        )

    def digest(self) -> str:
        """Computes the SHA-256 of the voltages."""
        return hashlib.sha256(np.ascontiguousarray(self.voltages).data).hexdigest()

    def against(
        self, reference: Any = "quiet", frames: float = 10, seconds: float = 60.0
    ) -> "PairRecording":
        """Returns the recording with the changes of its voltages against a reference.

        **Arguments:** `reference` is a frame (C, R) without a press, in the recording's
        units; "first", the mean of the first `frames`; "quiet", that of the first stretch
        of so many frames in which nothing is pressed; or "running", the median over
        `seconds`, where presses are shorter than half of them and voltages drift.
        **Raises:** `ValueError` for another reference, and where no stretch is quiet.

        **Example:**

        >>> import numpy as np
        >>> import tomojax as tx
        >>> volts = np.ones((30, 8, 4))
        >>> volts[20:25] += 0.5  # a press
        >>> box = (0.1, 0.1)
        >>> xy = 0.01 + 0.01 * np.indices((2, 4)).reshape(2, -1).T
        >>> pairs = tx.ert.Pairs.opposite(8)
        >>> read = tx.ert.PairRecording(volts, pairs, xy, 0.004, size=box)
        >>> print(read.against("first").voltages[[0, 22], 0, 0])
        [0.  0.5]
        """
        require(frames == int(frames), "frames", frames, "a whole number")
        told = self.voltages, self.t0, reference, int(frames), seconds
        return replace(self, voltages=self.voltages - reference_of(*told))

    def save(self, path: Path | str) -> None:
        """Writes the recording: .h5, .mat, or .csv with a line a frame and PATH.toml.

        **Raises:** `ValueError` for another ending.
        """
        told: dict[str, Any] = {
            n: getattr(self, n)
            for n in ("units", "notes", "f_switch", "magnitude", "electrode_diameter")
        }
        told |= {"schema": SCHEMA, "schema_version": VERSIONS[-1], "kind": KIND}
        told |= self.outline.attributes() | ({"size": self.size} if self.size else {})
        arrays = {
            "v": self.voltages.astype(np.float32),
            "t0": self.t0,
            "conditions/inject": self.pairs.inject.astype(np.uint16),
            "conditions/read": self.pairs.read.astype(np.uint16),
            "electrode_xy": self.electrode_xy,
        } | self.outline.datasets()
        if self.places is not None:
            arrays["places"] = self.places
        save_as(Path(path), arrays, told)


def load(path: Path | str) -> PairRecording:
    """Reads a recording of kind "conductivity", whole.

    **Raises:** `ValueError`, one line with the file, the field, the value found and the
    value expected.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.load("none.h5")
    Traceback (most recent call last):
    ValueError: none.h5: file: got none, or a folder, expected a recording
    """
    path = Path(path)
    try:
        require(path.is_file(), "file", "none, or a folder", "a recording")
        return _read(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def _read(path: Path) -> PairRecording:
    told = fields_of(path)
    for name, wanted in (("schema", SCHEMA), ("kind", KIND)):
        found = text(told, name, wanted)
        require(found == wanted, name, repr(found), repr(wanted))
    xy = electrodes_of(told)
    volts, pairs = readings_of(told, len(xy))
    given: dict[str, Any] = {n: number(n, told[n]) for n in NUMBERS[2:] if n in told}
    given |= {name: text(told, name) for name in ("units", "notes") if name in told}
    require("electrode_diameter" in given, "electrode_diameter", "none", "a number, m")
    recording = PairRecording(
        voltages=volts,
        pairs=pairs,
        electrode_xy=xy,
        outline=Outline.read(told, told.get) or Outline("rectangle"),
        size=size_of(told["size"]) if "size" in told else None,
        t0=np.ravel(told["t0"]) if "t0" in told else None,
        places=told.get("places"),
        magnitude=flag(told, "magnitude") if "magnitude" in told else None,
        path=path,
        **given,
    )
    reference = told.get("reference", "none")
    if isinstance(reference, bytes | str):
        reference = text(told, "reference", "none")
        if reference == "none":
            return recording
    else:
        shape = np.shape(told["v"])[1:]
        fits = np.size(reference) == np.prod(shape)
        require(fits, "reference", f"shape {np.shape(reference)}", f"{shape}, a frame")
        alone = {n: value for n, value in told.items() if n != "condition"}
        alone["v"] = np.reshape(reference, (1, *shape))
        reference = readings_of(alone, len(xy))[0][0]
    more = {n: number(n, told[n]) for n in ("frames", "seconds") if n in told}
    return recording.against(reference, **more)
