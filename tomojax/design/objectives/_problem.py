"""Makes a design's objective from a sensor, a method and the contacts' places."""

from typing import Any, get_args, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.stats import qmc

from tomojax._checks import checked, known, require, require_array
from tomojax._custom_types import Numbers
from tomojax._require import require_whole
from tomojax.design.objectives._contacts import blobs, Contact, without_current
from tomojax.design.objectives._image_error import simulated_image
from tomojax.design.objectives._information import (
    AbstractObjective,
    Criterion,
    ImageVariance,
    PlaceInformation,
)
from tomojax.design.objectives._scores import simulated_place_error
from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts import Noise, slot_weights, whitened
from tomojax.methods import Linear, noise_of, sheet_of, Source
from tomojax.paper import exploration
from tomojax.sensor import Sensor

DesignMethod = Literal["points", "linear", "source"]

# Radius of a contact that holds the sheet at V0, of the pitch.
_DISC = 0.1

# λ/σ₁² where the converter's noise alone limits an image.
_RELATIVE = 1e-6

# Directions of an image that are looked at, for each electrode.
_RANK = 2

# The width of a contact in an image (σ), of the pitch.
_BLOB = 0.4


def design_places(
    sensor: Sensor, region: Numbers | None = None, count: int = 64
) -> Float[Array, "count 2"]:
    """Spreads places for contacts, m, evenly over a region (x₀, y₀, x₁, y₁), by Halton.

    The default region is the sheet without a margin of half the electrodes' pitch.
    **Raises:** `ValueError` for a region that is empty or off the sheet, and a `count`
    below 1.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, region=(0.02, 0.02, 0.06, 0.06), count=4)
    >>> places.shape, bool((places > 0.02).all())  # m
    ((4, 2), True)
    """
    require_whole("count", count)
    size = np.asarray(sensor.size, float)
    margin = sensor.mean_pitch / 2
    given = [margin, margin, *(size - margin)] if region is None else region
    box = np.asarray(checked("region", given, "finite"), float)
    require(box.shape == (4,), "region", f"shape {box.shape}", "x0, y0, x1, y1")
    low, high = box[:2], box[2:]
    text = ", ".join(f"{v:g}" for v in box)
    require((low < high).all(), "region", text, "x0 < x1 and y0 < y1")
    inside = (low >= 0).all() and (high <= size * (1 + 1e-6)).all()
    require(inside, "region", text, f"on the sheet, 0 to {size[0]:g}, {size[1]:g}")
    # The sequence's first is the corner.
    unit = qmc.Halton(2, scramble=False).random(count + 1)[1:]
    return jnp.asarray(low + unit * (high - low), sensor.dtype)


def design_objective(
    sensor: Sensor,
    places: Numbers,
    method: str = "points",
    criterion: str = "place",
    *,
    lam: float | None = None,
    noise: Numbers | None = None,
    radius: float | None = None,
    conductance: float | None = None,
    grid: int = 32,
) -> AbstractObjective:
    """Makes a design's objective, over contacts at `places` (P, 2), m.

    **Arguments:**

    - `method`: "points" (`PlaceInformation`), or "linear" and "source" (`ImageVariance`, on
      `grid` × `grid` pixels).
    - `criterion`: "rigs", the errors on 16 simulated rigs that are not nominal. "points"
      counts errors of place (`SimulatedPlaceError`); "linear" adds the width of images
      (`SimulatedImage`). "place", the expected error of a contact's place (of an image the
      same as "a"); "a", the mean variance; "d", the volume that stays unknown; "worst", the
      largest of all places.
    - `lam`: λ of an image; by default the λ where the converter's noise alone limits
      images.
    - `noise`: a standard deviation, V; one for each channel (M,); or their covariance
      (M, M), V². "points" takes the errors of a rig with nominal values by default. Images
      take the same noise for all channels by default. Only relative values of an image's
      noise count: λ has the size.
    - `radius`, m, and `conductance`, S, of a contact: by default usual for `points`, and
      1e-4 S. Images have a Gaussian of σ `radius`, by default 0.4 pitches. "rigs" of
      "linear" has a disc, by default of 0.1 pitches and 1 S, which holds the sheet at V0.

    **Raises:** `ValueError` for places off the sheet or none, unknown names, λ ≤ 0, and a
    noise that is NaN, not symmetric or not positive.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "points", "place")
    >>> few, all_slots = jnp.zeros(16).at[:4].set(1), jnp.ones(16)
    >>> bool(objective.value(all_slots) < objective.value(few)), objective.unit
    (True, 'm')
    """
    for name, value, among in (
        ("method", method, get_args(DesignMethod)),
        ("criterion", criterion, get_args(Criterion)),
    ):
        require(value in among, name, repr(value), f"one of {', '.join(among)}")
    where = checked("places", places, "finite", (None, 2), dtype=sensor.dtype)
    require(len(where) > 0, "places", "none", "one place at least")
    if known(where):
        on = (np.asarray(where) >= 0) & (np.asarray(where) <= np.asarray(sensor.size))
        off = int((~on.all(1)).sum())
        require(off == 0, "places", f"{off} off the sheet", "places on it")
    for name, number in (("lam", lam), ("radius", radius), ("conductance", conductance)):
        if number is not None:
            checked(name, number, "positive")
    rigs = criterion == "rigs"
    fits = not rigs or method != "source"
    require(fits, "criterion", "'rigs' of 'source'", "another, or another method")
    # Simulated rigs know one grounded electrode a slot, by its own path to ground.
    fits = not rigs or sensor.conditions is None
    require(fits, "criterion", "'rigs' of a table of conditions", "'place' or another")
    told = noise is None or not rigs
    require(told, "noise", "a value for criterion 'rigs'", "none: rigs'")
    precision = None if noise is None else _precision(sensor, noise)
    metal = 1.0 if rigs and method == "linear" else 1e-4
    conductance = metal if conductance is None else conductance
    pitch, every = sensor.mean_pitch, jnp.asarray(sensor.all_grounds())
    if method == "points":
        contact = Contact.of(sheet_of(sensor), radius, conductance)
        if rigs:
            return simulated_place_error(sensor, contact, where)
        errors = noise_of(sensor) if precision is None else precision
        information = _information(contact, errors, where, every)
        return PlaceInformation(criterion, information, contact.sheet.unit)
    found = (Linear if method == "linear" else Source).of(sensor, (grid, grid))
    value = _RELATIVE * found.scale() if lam is None else lam
    if rigs:
        assert isinstance(found, Linear)
        disc = _DISC * pitch if radius is None else radius
        return simulated_image(sensor, found, where, value, disc, conductance)
    shares = None
    if method == "source":
        contact = Contact.of(sheet_of(sensor), radius, conductance)
        current = _currents(contact, where, every)
        shares = (current / current.mean(1, keepdims=True)) ** 2
    width = _BLOB * pitch if radius is None else radius
    return image_objective(found, where, criterion, value, precision, width, shares)


def _precision(sensor: Sensor, noise: Numbers) -> Float[Array, "M M"]:
    """Returns N⁻¹ of the noise, 1/V²."""
    m = sensor.electrode_count
    given = checked("noise", noise, "finite", (), (m,), (m, m), dtype=sensor.dtype)
    if given.ndim < 2:
        require_array("noise", given, "positive")
    covariance = given if given.ndim == 2 else jnp.diag(jnp.broadcast_to(given**2, (m,)))
    if not known(covariance):
        return jnp.linalg.inv(covariance)
    n = np.asarray(covariance, float)
    require(np.allclose(n, n.T), "noise", "no symmetric matrix", "a covariance")
    least = np.linalg.eigvalsh(n).min()
    require(least > 0, "noise", f"a least variance of {least:g}", "one above 0")
    return jnp.asarray(np.linalg.inv(n), sensor.dtype)


def image_objective(
    method: Linear | Source,
    places: Float[Array, "P 2"],
    criterion: str,
    lam: Any,
    precision: Float[Array, "M M"] | None,
    width: float,
    shares: Float[Array, "P L"] | None = None,
) -> ImageVariance:
    """Makes the objective of any J's images. Contacts are Gaussians of `width` (σ), m."""
    rank = _RANK * method.electrode_count
    factors, basis = method.all_factors()[..., :rank], method.basis[:rank]
    seen = factors
    if precision is not None:
        # λ keeps Eq. 3's unit: N relative to its mean variance.
        mean = jnp.mean(jnp.diagonal(jnp.linalg.inv(precision)))
        seen = jnp.einsum("mn,lnr->lmr", precision * mean, factors, precision="highest")
    grams = jnp.einsum("lmr,lms->lrs", factors, seen, precision="highest")
    columns = matmul(blobs(method.shape, method.cell, places, width), basis.T)
    columns = columns / jnp.linalg.norm(columns, axis=1, keepdims=True)
    if criterion == "d":
        # Orthonormal rows of the columns' span, for singular values above a tenth.
        _, s, vt = np.linalg.svd(np.asarray(columns, float), full_matrices=False)
        columns = jnp.asarray(vt[s > 0.1 * s[0]], columns.dtype)
    return ImageVariance(criterion, grams, columns, shares, jnp.asarray(lam, grams.dtype))


@jax.jit
def _information(
    contact: Contact,
    noise: Noise | Float[Array, "M M"],
    places: Float[Array, "P 2"],
    grounds: Int[Array, " L"],
) -> Float[Array, "P L 3 3"]:
    """Computes `points`' F_l at places; `noise` is that of `points`, or N⁻¹."""

    def one(place: Array, ground: Array) -> Float[Array, "3 3"]:
        columns = contact.columns(place, ground)
        if isinstance(noise, Noise):
            read = jnp.ones(columns.shape[1], bool)
            columns = seen = whitened(slot_weights(noise, columns[0], read), columns)
        else:
            seen = matmul(columns, noise)
        return without_current(matmul(columns, seen.T))

    return jax.lax.map(lambda x: jax.vmap(one, (None, 0))(x, grounds), places)


@jax.jit
def _currents(
    contact: Contact, places: Float[Array, "P 2"], grounds: Int[Array, " L"]
) -> Float[Array, "P L"]:
    return jax.vmap(jax.vmap(contact.current, (None, 0)), (0, None))(places, grounds)


@jax.jit
def _voltages(
    contact: Contact, places: Float[Array, "P 2"], grounds: Int[Array, " L"]
) -> Float[Array, "P L M"]:
    one = lambda place, ground: contact.columns(place, ground)[0]  # noqa: E731
    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(places, grounds)


def exploratory_voltages(
    sensor: Sensor,
    places: Float[Array, "P 2"],
    radius: float | None = None,
    conductance: float = 1e-4,
) -> Float[Array, "P 2 M"]:
    """Computes contacts' voltages, V, under the two exploratory grounds (`exploration`).

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> tx.design.exploratory_voltages(sensor, places).shape
    (4, 2, 16)
    """
    contact = Contact.of(sheet_of(sensor), radius, conductance)
    return _voltages(contact, places, exploration(sensor))
