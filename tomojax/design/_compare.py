"""Ground patterns side by side: images by Eq. 3, each pattern at the λ of one width.

λ is a trade of place for width: patterns at one λ have images of different widths, whose
errors of place say little. So each takes the λ that makes its images equally wide.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer

from tomojax import paper
from tomojax._custom_types import Numbers
from tomojax._require import library, require
from tomojax._shown import html_table
from tomojax.design._design import grounds_of_each
from tomojax.design.objectives._problem import design_places
from tomojax.design.objectives._rigs import simulate_scenes
from tomojax.kernels.images import half_width, image_place
from tomojax.sensor import ground_set, jacobian, Sensor
from tomojax.step import ADAPTIVE

# λ/σ₁² of the search, and bisections after it.
_LAMS = 10.0 ** np.arange(-8, 0.1)
_BISECTIONS = 10

# A width that is off by less is reached.
_ALIKE = 0.03

# Rows of the basis that stands for J, for each electrode.
_RANK = 2

# Radius of a contact, of the pitch.
_RADIUS = 0.1


class PatternFigures(NamedTuple):
    """A pattern at the width that it shares with the others.

    **Example:**

    >>> import tomojax as tx
    >>> row = tx.design.PatternFigures("mine", 3, 0, 0.3, 1e-4, 20.0, 1.5, 4.0, True)
    >>> row.slots, row.place_median_mm
    (3, 1.5)
    """

    pattern: str
    slots: int  # of a scan, without the exploratory ones
    exploratory_slots: int  # 2 of an adaptive pattern
    dt_ms: float  # of `slots`, as the paper counts
    lam_relative: float  # λ/σ₁², σ₁ of all grounds
    width_mm: float  # full width at half maximum, the median
    place_median_mm: float  # error of place
    place_p90_mm: float
    equally_wide: bool  # False: no λ makes its images so wide


@dataclass(frozen=True)
class PatternTable:
    """Patterns compared: `rows`, at the width `width_mm`, over so many `contacts`.

    **Example:**

    >>> import tomojax as tx
    >>> row = tx.design.PatternFigures("mine", 3, 0, 0.3, 1e-4, 20.0, 1.5, 4.0, True)
    >>> tx.design.PatternTable((row,), 20.0, 48)
    images 20 mm wide (full width at half maximum), 48 simulated contacts of metal
    pattern       slots  Δt, ms  λ/σ₁²    width, mm  place, mm: median  90 %
    mine              3    0.30  1.0e-04       20.0               1.50  4.00
    """

    rows: tuple[PatternFigures, ...]
    width_mm: float
    contacts: int

    def __repr__(self) -> str:
        lines = [
            self._title(),
            "pattern       slots  Δt, ms  λ/σ₁²    width, mm  place, mm: median  90 %",
        ]
        for r in self.rows:
            slots = f"{r.slots}+{r.exploratory_slots}" if r.exploratory_slots else r.slots
            note = "" if r.equally_wide else "  (another width)"
            lines.append(
                f"{r.pattern[:12]:12s}  {slots!s:>5s}  {r.dt_ms:6.2f}"
                f"  {r.lam_relative:.1e}  {r.width_mm:9.1f}"
                f"  {r.place_median_mm:17.2f}  {r.place_p90_mm:4.2f}{note}"
            )
        if any(r.exploratory_slots for r in self.rows):
            lines.append("+2: two corner slots explore first; Δt leaves them out")
        return "\n".join(lines)

    def _title(self) -> str:
        wide = f"images {self.width_mm:.3g} mm wide (full width at half maximum)"
        return f"{wide}, {self.contacts} simulated contacts of metal"

    def _repr_html_(self) -> str:
        rows = [[f"{v:.3g}" if isinstance(v, float) else v for v in r] for r in self.rows]
        return html_table(rows, PatternFigures._fields, self._title())

    def to_pandas(self) -> Any:
        """Returns a DataFrame; pandas is an extra, `tomojax[tables]`."""
        return library("pandas", "tables").DataFrame(list(self.rows))


def compare_patterns(
    sensor: Sensor,
    patterns: Mapping[str, str | Numbers] | Sequence[str] = paper.PATTERNS,
    *,
    width: float | None = None,
    contacts: int = 48,
    f_switch: float = 10e3,
    rigs: int = 4,
    seed: int = 0,
) -> PatternTable:
    """Compares ground patterns on simulated contacts, where their images are equally wide.

    Contacts lie evenly over the sheet on rigs that are not nominal, see `simulate_scenes`;
    Eq. 3 knows nominal values. An adaptive pattern explores each contact by two slots,
    which neither `slots` nor `dt_ms` counts.

    **Arguments:** `patterns`: by your names, numbers of electrodes or one of the paper's
    patterns; `width` m, full at half maximum, an electrodes' pitch by default; `contacts`
    that are simulated; `f_switch` slots/s; `rigs` that take turns; `seed` of rigs and
    random patterns.
    **Raises:** `ValueError` for no patterns, unknown names, grounds that are no electrodes
    or repeat.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> patterns = {"mine": [0, 7, 14], "around": "around", "all": "all"}
    >>> table = tx.design.compare_patterns(sensor, patterns, contacts=8, rigs=1)
    >>> [(row.pattern, row.slots) for row in table.rows]
    [('mine', 3), ('around', 8), ('all', 16)]
    >>> table.rows[2].place_median_mm < table.rows[0].place_median_mm
    True
    """
    given = patterns if isinstance(patterns, Mapping) else {name: name for name in patterns}
    require(len(given) > 0, "patterns", "none", "at least one")
    wide = sensor.mean_pitch if width is None else float(width)
    require(np.isfinite(wide) and wide > 0, "width", width, "m, above 0")
    rate = np.isfinite(f_switch) and f_switch > 0
    require(rate, "f_switch", f_switch, "slots/s, above 0")
    checked = {name: _checked(sensor, name, one) for name, one in given.items()}
    places = design_places(sensor, count=contacts)
    radius = _RADIUS * sensor.mean_pitch
    sensor = _on_coarse_mesh(sensor)
    scenes = simulate_scenes(sensor, places, radius=radius, rigs=rigs, seed=seed)
    explored = scenes.voltages[:, paper.exploration(sensor)]
    images = _Images.of(sensor, np.asarray(scenes.voltages, float))
    rows = []
    for name, one in checked.items():
        sets = grounds_of_each(sensor, one, explored, seed)
        lam, width_m, off = _at_width(sensor, images, sets, wide, places)
        slots = sets.shape[1]
        rows.append(
            PatternFigures(
                pattern=name,
                slots=slots,
                exploratory_slots=2 if isinstance(one, str) and one in ADAPTIVE else 0,
                dt_ms=1e3 * slots / f_switch,
                lam_relative=lam,
                width_mm=1e3 * width_m,
                place_median_mm=1e3 * float(np.median(off)),
                place_p90_mm=1e3 * float(np.quantile(off, 0.9)),
                equally_wide=abs(width_m / wide - 1) < _ALIKE,
            )
        )
    return PatternTable(tuple(rows), 1e3 * wide, contacts)


def _on_coarse_mesh(sensor: Sensor) -> Sensor:
    """Returns the sensor on the coarsest mesh that its electrodes and its sheet allow."""
    if sensor.sheet_resistance.ndim:
        return sensor
    diameter = float(sensor.electrode_diameter) * (1 + 1e-5)
    nx, ny = np.ceil(np.asarray(sensor.size, float) / diameter).astype(int)
    return replace(sensor, divisions=(max(2, int(nx)), max(2, int(ny))))


def _checked(sensor: Sensor, name: str, one: str | Numbers) -> str | np.ndarray:
    argument = f"patterns[{name!r}]"
    if isinstance(one, str):
        wanted = f"grounds or one of {', '.join(paper.PATTERNS)}"
        require(one in paper.PATTERNS, argument, repr(one), wanted)
        return one
    grounds = np.asarray(ground_set(sensor, one))
    whole = grounds.ndim == 1 and len(np.unique(grounds)) == len(grounds)
    require(whole, argument, one, "numbers of electrodes, each at most once")
    return grounds


class _Images(NamedTuple):
    """Holds what Eq. 3 takes of each slot, for all contacts."""

    grams: Float[np.ndarray, "L r r"]
    rights: Float[np.ndarray, "P L r"]
    basis: Float[np.ndarray, "r pixels"]
    scale: float  # σ₁²

    @classmethod
    def of(cls, sensor: Sensor, volts: Float[np.ndarray, "P L M"]) -> "_Images":
        # An even sheet has a J without the mesh's errors, as in method "linear".
        maps = jacobian(sensor, route="fem" if sensor.sheet_resistance.ndim else "series")
        most = min(len(maps) * maps.shape[1], maps.shape[2])
        reduced = paper.reduce_jacobian(maps, min(_RANK * sensor.electrode_count, most))
        factors, grams = (np.asarray(a, float) for a in (reduced.factors, reduced.grams))
        rights = np.einsum("lmr,plm->plr", factors, volts, optimize=True)
        basis = np.asarray(paper.pixels(sensor, reduced.basis), float)
        scale = float(np.linalg.eigvalsh(grams.sum(0))[-1])
        return cls(grams, rights, basis.reshape(len(basis), -1), scale)

    def of_sets(
        self, sets: Integer[np.ndarray, "P L"]
    ) -> Callable[[float], Float[np.ndarray, "P pixels"]]:
        """Returns the images of all contacts as a function of λ."""
        rights = np.stack([b[some].sum(0) for b, some in zip(self.rights, sets)])
        alike, which = np.unique(np.sort(sets, 1), axis=0, return_inverse=True)
        parts = []
        for k, grounds in enumerate(alike):
            values, vectors = np.linalg.eigh(self.grams[grounds].sum(0))
            mine = np.flatnonzero(which.ravel() == k)
            parts.append((mine, np.maximum(values, 0), vectors, rights[mine] @ vectors))

        def images(lam: float) -> Float[np.ndarray, "P pixels"]:
            solved = np.empty_like(rights)
            for mine, values, vectors, turned in parts:
                solved[mine] = turned / (values + lam) @ vectors.T
            return solved @ self.basis

        return images


def _at_width(
    sensor: Sensor,
    images: _Images,
    sets: Integer[np.ndarray, "P L"],
    wide: float,
    places: Float[Array, "P 2"],
) -> tuple[float, float, Float[np.ndarray, " P"]]:
    """Finds λ/σ₁² of a width; returns it, the width reached, and errors of place, m."""
    of_lam = images.of_sets(sets)

    def measured(lam: float) -> tuple[float, np.ndarray]:
        found = jnp.asarray(of_lam(lam * images.scale), sensor.dtype)
        found = found.reshape(-1, *sensor.divisions)
        widths, at = _measured(found, paper.cell_size(sensor))
        return 2 * float(np.median(widths)), np.asarray(at)

    # From the narrow end: with the smallest λ noise makes an image of its own.
    widths = np.array([measured(lam)[0] for lam in _LAMS])
    narrow = int(widths.argmin())
    beyond = np.flatnonzero(widths[narrow:] >= wide)
    if not len(beyond):
        lam = float(_LAMS[-1])
    elif beyond[0] == 0:
        lam = float(_LAMS[narrow])
    else:
        high = float(_LAMS[narrow + beyond[0]])
        low = float(_LAMS[narrow + beyond[0] - 1])
        for _ in range(_BISECTIONS):
            lam = float(np.sqrt(low * high))
            low, high = (lam, high) if measured(lam)[0] < wide else (low, lam)
        lam = high
    width, at = measured(lam)
    return lam, width, np.linalg.norm(at - np.asarray(places), axis=1)


@jax.jit
def _measured(
    images: Float[Array, "P nx ny"], cell: Float[Array, "2"]
) -> tuple[Float[Array, " P"], Float[Array, "P 2"]]:
    widths = jax.vmap(half_width, (0, None))(images, cell)
    return widths, jax.vmap(image_place, (0, None))(images, cell)
