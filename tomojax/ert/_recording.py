"""Reads and writes recordings of pairs: recording version 2, kind "conductivity"."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require, require_kind
from tomojax._shown import named
from tomojax._whole import whole
from tomojax.ert._pairs import Pairs
from tomojax.files import open_container
from tomojax.recordings import number, Outline, SCHEMA, size_of, VERSIONS

if TYPE_CHECKING:
    import tomojax.sensor

KIND = "conductivity"
_NUMBERS = "scale", "offset", "electrode_diameter", "f_switch"


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

    def sensor(self, dtype: Any = np.float32) -> "tomojax.sensor.Sensor":
        """Makes the sensor, whose places are the recording's less `origin`.

        The sheet has the nominal resistance of `Sensor`.
        """
        from tomojax.sensor import Sensor  # needs JAX, which reading does not

        loops = tuple(loop - self.origin for loop in self.outline.loops)
        return Sensor.cut(
            self.box,
            electrodes=self.electrode_xy - self.origin,
            electrode_diameter=self.electrode_diameter,
            dtype=dtype,
            **replace(self.outline, loops=loops).sheet(self.box),
        )

    def digest(self) -> str:
        """Computes the SHA-256 of the voltages."""
        return hashlib.sha256(np.ascontiguousarray(self.voltages).data).hexdigest()

    def save(self, path: Path | str) -> None:
        """Writes the recording to a file (HDF5)."""
        import h5py

        names = "units", "notes", "f_switch", "magnitude", "electrode_diameter"
        told = {name: getattr(self, name) for name in names}
        told |= {"schema": SCHEMA, "schema_version": VERSIONS[-1], "kind": KIND}
        told |= self.outline.attributes() | ({"size": self.size} if self.size else {})
        condition = np.broadcast_to(np.arange(self.pairs.conditions), self.bad.shape[:2])
        arrays = {
            "v": self.voltages.astype(np.float32),
            "t0": self.t0,
            "condition": condition.astype(np.uint16),
            "conditions/inject": self.pairs.inject.astype(np.uint16),
            "conditions/read": self.pairs.read.astype(np.uint16),
            "electrode_xy": self.electrode_xy,
        } | self.outline.datasets()
        with whole(path) as part, h5py.File(part, "w") as file:
            file.attrs.update(told)
            for name, values in arrays.items():
                file[name] = values
            if self.places is not None:
                file["places"] = self.places


def load(path: Path | str) -> PairRecording:
    """Reads a recording of kind "conductivity", whole.

    **Raises:** `ValueError`, one line with the file, the field, the value found and the
    value expected.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.load("none.h5")
    Traceback (most recent call last):
    ValueError: none.h5: file: got none, or a folder, expected a recording in HDF5
    """
    path = Path(path)
    try:
        require(path.is_file(), "file", "none, or a folder", "a recording in HDF5")
        with open_container(path) as file:
            return _read(path, file)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def _read(path: Path, file: Any) -> PairRecording:
    told, names = file.attributes, file.names
    for name, wanted in (("schema", SCHEMA), ("kind", KIND)):
        require(told.get(name) == wanted, name, repr(told.get(name)), repr(wanted))

    def dataset(name: str, axes: int | None = None) -> Any:
        if axes is None and name not in names:
            return None
        require(name in names, name, f"only {sorted(names)[:20]}", "it")
        values = file.read_whole(name)
        fits = values.dtype.kind in "iuf" and axes in (None, values.ndim)
        require(fits, name, f"{values.dtype} {values.shape}", f"numbers on {axes} axes")
        return values

    pairs = Pairs(dataset("conditions/inject", 2), dataset("conditions/read", 3))
    given: dict[str, Any] = {n: number(n, told[n]) for n in _NUMBERS if n in told}
    volts = given.pop("scale", 1.0) * dataset("v", 3) + given.pop("offset", 0.0)
    if "condition" in names:
        condition, c = dataset("condition", 2), pairs.conditions
        fits, shape = condition.shape == volts.shape[:2], f"shape {condition.shape}"
        require(fits, "condition", shape, f"{volts.shape[:2]}, as v has")
        inside = np.isin(condition, np.arange(c)).all()
        require(inside, "condition", int(condition.max(initial=0)), f"0 to {c - 1}")
        ordered = np.full((len(volts), c, volts.shape[2]), np.nan)
        ordered[np.arange(len(volts))[:, None], condition.astype(int)] = volts
        volts = ordered
    given |= {name: str(told[name]) for name in ("units", "notes") if name in told}
    require("electrode_diameter" in given, "electrode_diameter", "none", "a number, m")
    return PairRecording(
        voltages=volts,
        pairs=pairs,
        electrode_xy=dataset("electrode_xy", 2),
        outline=Outline.read(told, dataset) or Outline("rectangle"),
        size=size_of(told["size"]) if "size" in told else None,
        t0=dataset("t0", 1),
        places=dataset("places"),
        magnitude=bool(told["magnitude"]) if "magnitude" in told else None,
        path=path,
        **given,
    )
