"""`tomojax table1`: predicts the paper's Table I from a single number of its own.

Protocol. J(0) is of the paper's sensor on its 4 mm mesh. A contact is one element; its
voltages are its column of J. One λ serves all patterns: with this λ, *All* has the paper's
width. The width is half the width at half the maximum (mean of ±x, ±y). The other eight
widths are then predictions.

Contacts are a fixed low-discrepancy set over the sheet. The table takes only contacts two
pitches or more from the sheet's edge. Each contact has random patterns of its own. The
study sweeps and draws the effects of these choices.

The study goes beyond the paper in two ways. It gives the error of each contact's place. It
also repeats both on voltages of a 10 mm disc from the exact contact model, on a finer mesh.
A 16-bit converter reads these voltages.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.images import half_area_radius, half_width, image_place
from tomojax.kernels.inverse import ReducedSlots
from tomojax.kernels.sheet import centroids
from tomojax.paper import (
    AdaptiveScan,
    cell_size,
    exploration,
    pattern,
    PATTERNS,
    reduce_jacobian,
)
from tomojax.sensor import Converter, Disc, jacobian, Sensor, voltages

F_SWITCH = 10e3  # Hz

# Table I: width in mm, Δt in ms.
PAPER = {
    "all": (32.2, 6.4),
    "around": (45.6, 0.80),
    "cop_line": (50.0, 0.80),
    "point": (62.2, 0.60),
    "boundary": (46.3, 2.80),
    "v_line": (60.0, 0.80),
    "edge": (57.8, 0.80),
    "random_16": (49.0, 1.60),
    "random_8": (56.6, 0.80),
}

_RANK = 256  # at the λ of this table: images right to 3e-4
_COARSE = (40, 40)  # the paper's 4 mm
_FINE = (64, 64)  # mesh of the exact voltages; not the reconstruction's
_SWEEP = np.geomspace(0.03, 10, 11)  # λ over the table's
MARGINS = (0.010, 0.020, 0.030, 0.040, 0.050, 0.060)  # m from the edge; the table's: 0.040
_MARGIN = 0.040
SHOWN = (0.094, 0.067)  # m: the contact of the pictures, off centre and off the electrodes


class Measured(NamedTuple):
    """Figures of images, for each contact and λ."""

    half_width: Float[Array, "P G"]  # m
    half_area_radius: Float[Array, "P G"]  # m
    place_error: Float[Array, "P G"]  # m


class Study(NamedTuple):
    """Everything that the table, the JSON and the pictures show."""

    size: np.ndarray  # (2,) m
    places: np.ndarray  # (P, 2) m, of the contacts
    inside: np.ndarray  # (P,) which the table averages over
    lam: float
    sweep: np.ndarray  # (G,) λ
    patterns: dict[str, np.ndarray]  # grounds, (L,) or (P, L) where they differ
    own: dict[str, Measured]  # on J's own voltages, over the sweep
    exact: dict[str, Measured]  # the table's, on exact, converted voltages, at λ (G = 1)
    images: dict[str, np.ndarray]  # (nx, ny) of the contact `SHOWN`


def run(contacts: int = 100, progress: Callable[[str], None] = lambda text: None) -> Study:
    """Runs the protocol with `contacts` over the sheet; `progress` is told each step."""
    sensor = Sensor.grid(divisions=_COARSE)
    progress("Jacobian")
    jac = jacobian(sensor)
    reduced = reduce_jacobian(jac, _RANK)
    middles = centroids(sensor.divisions, sensor.size)
    elements = _contact_elements(np.asarray(middles), np.asarray(sensor.size), contacts)
    places = middles[elements]
    own = jnp.moveaxis(jac[:, :, elements], -1, 0)
    problem = _Problem(sensor, reduced, places)
    table = ((places >= _MARGIN) & (places <= sensor.size - _MARGIN)).all(1)
    inner = problem._replace(places=places[table])
    progress("exact voltages")
    exact = _exact_voltages(inner.places)
    patterns = {name: _grounds(sensor, name, own) for name in PATTERNS}
    lam = _calibrated(inner, patterns["all"], own[table])
    lams = jnp.asarray(lam * np.append(_SWEEP, 1.0), sensor.dtype)
    on_own, on_exact = {}, {}
    for name in PATTERNS:
        progress(f"pattern {name}")
        on_own[name] = problem.measure(patterns[name], own, lams)
        grounds = _grounds(sensor, name, exact)
        on_exact[name] = inner.measure(grounds, exact, lams[-1:])
    size, inside = np.asarray(sensor.size), np.asarray(table)
    shown = int(((np.asarray(places) - SHOWN) ** 2).sum(1).argmin())
    images = {
        name: problem.image(patterns[name], own, lams[-1], shown) for name in PATTERNS
    }
    return Study(
        size,
        np.asarray(places),
        inside,
        lam,
        np.asarray(lams[:-1]),
        patterns,
        on_own,
        on_exact,
        images,
    )


def _contact_elements(middles: np.ndarray, size: np.ndarray, count: int) -> np.ndarray:
    """Returns elements nearest to a low-discrepancy set (R₂), 10 mm off the edge."""
    g = 1.32471795724474602596  # the root of x³ = x + 1
    unit = (0.5 + np.outer(np.arange(count), [1 / g, 1 / g**2])) % 1
    wanted = MARGINS[0] + unit * (size - 2 * MARGINS[0])
    away = ((wanted[:, None] - middles) ** 2).sum(-1)
    return away.argmin(1)


def _exact_voltages(places: Array) -> Float[Array, "P L M"]:
    fine = Sensor.grid(divisions=_FINE)
    keys = jax.random.split(jax.random.key(0), len(places))

    def one(place_and_key: tuple[Array, Array]) -> Array:
        place, key = place_and_key
        return voltages(fine, Disc(place, 0.005, 2.0), converter=Converter(), key=key)

    return jax.jit(lambda *each: jax.lax.map(one, each))(places, keys)


def _grounds(sensor: Sensor, name: str, volts: Float[Array, "P L M"]) -> np.ndarray:
    if name in ("around", "cop_line", "point"):
        scan = AdaptiveScan(sensor, name)
        explored = volts[:, exploration(sensor)]
        return np.asarray(eqx.filter_jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    if name.startswith("random"):
        return np.stack([pattern(sensor, name, seed=i) for i in range(len(volts))])
    return np.asarray(pattern(sensor, name))


class _Problem(NamedTuple):
    sensor: Sensor
    reduced: ReducedSlots
    places: Float[Array, "P 2"]

    def measure(
        self, grounds: np.ndarray, volts: Float[Array, "P L M"], lams: Float[Array, " G"]
    ) -> Measured:
        """Measures all contacts' images for each λ. Sums of blocks first: one trace for
        all.
        """
        return _figures(
            *_sums(self.reduced, self._slots(grounds), volts),
            self.reduced.basis,
            lams,
            self.places,
            cell_size(self.sensor),
        )

    def image(self, grounds: np.ndarray, volts: Array, lam: Array, i: int) -> np.ndarray:
        """Returns the image (nx, ny) of contact i."""
        slots = self._slots(grounds)[i : i + 1]
        grams, rights = _sums(self.reduced, slots, volts[i : i + 1])
        return np.asarray(_image(grams[0], rights[0], self.reduced.basis, lam))

    def _slots(self, grounds: np.ndarray) -> Array:
        shape = (len(self.places), grounds.shape[-1])
        return jnp.asarray(np.broadcast_to(grounds, shape))


@jax.jit
def _sums(reduced: ReducedSlots, slots: Array, volts: Array):
    """Returns Σ A_lᵀA_l and Σ A_lᵀv_l over each contact's slots."""

    def one(chosen_and_voltages: tuple[Array, Array]) -> tuple[Array, Array]:
        chosen, v = chosen_and_voltages
        factors, read = reduced.factors[chosen], v[chosen]
        right = jnp.einsum("smr,sm->r", factors, read, precision="highest")
        return reduced.grams[chosen].sum(0), right

    return jax.lax.map(one, (slots, volts))


@jax.jit
def _figures(grams, rights, basis, lams, places, cell) -> Measured:
    def one(gram: Array, right: Array, place: Array, lam: Array) -> Measured:
        image = _image(gram, right, basis, lam)
        away = jnp.linalg.norm(image_place(image, cell) - place)
        return Measured(half_width(image, cell), half_area_radius(image, cell), away)

    def over_lams(contact: tuple[Array, Array, Array]) -> Measured:
        return jax.lax.map(lambda lam: one(*contact, lam), lams)

    return jax.lax.map(over_lams, (grams, rights, places))


@jax.jit
def _image(gram, right, basis, lam) -> Float[Array, "nx ny"]:
    system = gram + lam * jnp.eye(len(gram), dtype=gram.dtype)
    solution = jax.scipy.linalg.solve(system, right, assume_a="pos")
    return (solution @ basis).reshape(*_COARSE, 2).mean(-1)


def _calibrated(inner: _Problem, grounds: np.ndarray, volts: Array) -> float:
    """Finds the λ at which *All* has the paper's mean width."""
    strongest = jnp.linalg.eigvalsh(inner.reduced.grams.sum(0))[-1]
    low, high = -5.0, -1.0  # log10 of λ/σ₁²
    for _ in range(4):
        grid = np.linspace(low, high, 9)
        lams = jnp.asarray(strongest * 10.0**grid, strongest.dtype)
        widths = 1e3 * np.asarray(inner.measure(grounds, volts, lams).half_width)
        above = int(np.argmax(widths.mean(0) > PAPER["all"][0]))
        low, high = grid[max(above - 1, 0)], grid[above]
    return float(strongest) * 10.0 ** ((low + high) / 2)
