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
from typing import cast, get_args, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Integer

from tomojax import paper
from tomojax.kernels.images import half_area_radius, half_width, image_place
from tomojax.kernels.inverse import ReducedSlots, solve_damped
from tomojax.kernels.sheet import centroids
from tomojax.sensor import Converter, Disc, jacobian, Sensor, voltages

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
ADAPTIVE = get_args(paper.AdaptivePattern)

MARGIN = 0.040  # m from the edge, of the table's contacts
_CONTACTS = 100
_NEAREST = 0.010  # m from the edge, of all contacts
_RANK = 256  # at the λ of this table: images right to 3e-4
_COARSE = (40, 40)  # the paper's 4 mm
_FINE = (64, 64)  # mesh of the exact voltages; not the reconstruction's
_SWEEP = np.geomspace(0.03, 10, 11)  # λ over the table's
_SHOWN = (0.094, 0.067)  # m: a contact off centre and off the electrodes

# Figures of images, mm, for each contact and λ: half_width, half_area_radius, place_error.
Figures = dict[str, Float[np.ndarray, "P G"]]


class Study(NamedTuple):
    """Everything that the table, the JSON and the pictures show; dicts are by pattern."""

    sensor: Sensor
    places: Float[np.ndarray, "P 2"]  # m, of the contacts
    lams: Float[np.ndarray, " G"]  # of the sweep, and the table's
    grounds: dict[str, Integer[np.ndarray, "P L"]]
    own: dict[str, Figures]  # on J's own voltages
    exact: dict[str, Figures]  # the table's contacts: exact, converted voltages, its λ
    images: dict[str, Float[np.ndarray, "nx ny"]]  # of the contact `shown`

    def inside(self, margin: float = MARGIN) -> Bool[np.ndarray, " P"]:
        """Tells which contacts are so far from the sheet's edge, m."""
        size = np.asarray(self.sensor.size)
        return np.all((self.places >= margin) & (self.places <= size - margin), axis=1)

    @property
    def shown(self) -> int:
        """The contact of the pictures."""
        return int(((self.places - _SHOWN) ** 2).sum(1).argmin())


def run(progress: Callable[[str], None] = lambda step: None) -> Study:
    """Runs the protocol; `progress` is told each of the eleven steps."""
    sensor = Sensor.grid(divisions=_COARSE)
    progress("Jacobian")
    jac = jacobian(sensor)
    reduced = paper.reduce_jacobian(jac, _RANK)
    middles = np.asarray(centroids(sensor.divisions, sensor.size))
    elements = _contact_elements(middles, np.asarray(sensor.size))
    own = jnp.moveaxis(jac[:, :, elements], -1, 0)
    study = Study(sensor, middles[elements], _SWEEP, {}, {}, {}, {})
    inside, cell = study.inside(), paper.cell_size(sensor)
    places = study.places[inside]
    progress("exact voltages")
    exact = _exact_voltages(places)
    everywhere = _grounds(sensor, "all", own[inside])
    sums = _sums(reduced, everywhere, own[inside])
    lam = _calibrated(reduced, sums, places, cell)
    study = study._replace(lams=lam * np.append(_SWEEP, 1.0))
    lams = jnp.asarray(study.lams, sensor.dtype)
    for name in paper.PATTERNS:
        progress(f"pattern {name}")
        study.grounds[name] = _grounds(sensor, name, own)
        grams, rights = _sums(reduced, study.grounds[name], own)
        study.own[name] = _measured(reduced, (grams, rights), lams, study.places, cell)
        one = (each[study.shown] for each in (grams, rights))
        study.images[name] = np.asarray(_image(*one, reduced.basis, lams[-1]))
        sums = _sums(reduced, _grounds(sensor, name, exact), exact)
        study.exact[name] = _measured(reduced, sums, lams[-1:], places, cell)
    return study


def _contact_elements(middles: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Returns elements nearest to a low-discrepancy set (R₂)."""
    g = 1.32471795724474602596  # the root of x³ = x + 1
    unit = (0.5 + np.outer(np.arange(_CONTACTS), [1 / g, 1 / g**2])) % 1
    wanted = _NEAREST + unit * (size - 2 * _NEAREST)
    away = ((wanted[:, None] - middles) ** 2).sum(-1)
    return away.argmin(1)


def _exact_voltages(places: np.ndarray) -> Float[Array, "P L M"]:
    fine = Sensor.grid(divisions=_FINE)
    keys = jax.random.split(jax.random.key(0), len(places))

    def one(place_and_key: tuple[Array, Array]) -> Array:
        place, key = place_and_key
        return voltages(fine, Disc(place, 0.005, 2.0), converter=Converter(), key=key)

    return jax.jit(lambda *each: jax.lax.map(one, each))(places, keys)


def _grounds(
    sensor: Sensor, name: str, volts: Float[Array, "P L M"]
) -> Integer[np.ndarray, "P S"]:
    if name in ADAPTIVE:
        scan = paper.AdaptiveScan(sensor, cast(paper.AdaptivePattern, name))
        explored = volts[:, paper.exploration(sensor)]
        return np.asarray(eqx.filter_jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    # Each contact has random patterns of its own.
    return np.stack([paper.pattern(sensor, name, seed=i) for i in range(len(volts))])


@jax.jit
def _sums(reduced: ReducedSlots, grounds: Array, volts: Array) -> tuple[Array, Array]:
    """Returns Σ A_lᵀA_l and Σ A_lᵀv_l over each contact's slots: one trace for all λ."""

    def one(chosen_and_voltages: tuple[Array, Array]) -> tuple[Array, Array]:
        chosen, v = chosen_and_voltages
        factors, read = reduced.factors[chosen], v[chosen]
        right = jnp.einsum("smr,sm->r", factors, read, precision="highest")
        return reduced.grams[chosen].sum(0), right

    return jax.lax.map(one, (grounds, volts))


def _measured(
    reduced: ReducedSlots,
    sums: tuple[Array, Array],
    lams: Float[Array, " G"],
    places: Float[np.ndarray, "P 2"],
    cell: Float[Array, "2"],
) -> Figures:
    """Measures all contacts' images for each λ."""
    found = _figures(*sums, reduced.basis, lams, places, cell)
    return {name: 1e3 * np.asarray(values, float) for name, values in found.items()}


@jax.jit
def _figures(grams, rights, basis, lams, places, cell) -> dict[str, Float[Array, "P G"]]:
    def one(gram: Array, right: Array, place: Array, lam: Array) -> dict[str, Array]:
        image = _image(gram, right, basis, lam)
        return {
            "half_width": half_width(image, cell),
            "half_area_radius": half_area_radius(image, cell),
            "place_error": jnp.linalg.norm(image_place(image, cell) - place),
        }

    def over_lams(contact: tuple[Array, Array, Array]) -> dict[str, Array]:
        return jax.lax.map(lambda lam: one(*contact, lam), lams)

    return jax.lax.map(over_lams, (grams, rights, places))


@jax.jit
def _image(gram, right, basis, lam) -> Float[Array, "nx ny"]:
    solution = solve_damped(gram, right, lam)
    return (solution @ basis).reshape(*_COARSE, 2).mean(-1)


def _calibrated(reduced: ReducedSlots, sums: tuple[Array, Array], places, cell) -> float:
    """Finds the λ at which *All* has the paper's mean width."""
    strongest = jnp.linalg.eigvalsh(reduced.grams.sum(0))[-1]
    low, high = -5.0, -1.0  # log10 of λ/σ₁²
    for _ in range(4):
        grid = np.linspace(low, high, 9)
        lams = jnp.asarray(strongest * 10.0**grid, strongest.dtype)
        widths = _measured(reduced, sums, lams, places, cell)["half_width"]
        above = int(np.argmax(widths.mean(0) > PAPER["all"][0]))
        low, high = grid[max(above - 1, 0)], grid[above]
    return float(strongest) * 10.0 ** ((low + high) / 2)
