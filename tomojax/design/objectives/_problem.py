"""Makes a design's objective from a sensor, a method and the contacts' places."""

from typing import Any, get_args, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from tomojax._checks import (
    float_array,
    known,
    require,
    require_finite,
    require_positive,
    require_shape,
)
from tomojax._custom_types import Numbers
from tomojax.design.objectives._contacts import blobs, contact_columns, contact_current
from tomojax.design.objectives._images import simulated_image
from tomojax.design.objectives._information import (
    AbstractObjective,
    Criterion,
    ImageVariance,
    PlaceInformation,
)
from tomojax.design.objectives._scores import simulated_place_error
from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts import Noise, Sheet, SIZE_WIDTH, slot_weights, weighed
from tomojax.methods import Linear, noise_of, sheet_of, Source, UNIT
from tomojax.paper import exploration
from tomojax.sensor import Sensor

DesignMethod = Literal["points", "linear", "source"]

# What is known of a contact beforehand: its place to a pitch, in units of the fit, and its
# size (in units of what `points` knows of it). Without the first, one slot may say nothing.
_PLACE_KNOWN = 1 / UNIT

# Radius of a contact that holds the sheet at V0, of the pitch.
_DISC = 0.1

# λ/σ₁² where the converter's noise alone limits an image, directions of an image that are
# looked at for each electrode, and the width of a contact in it (σ), of the pitch.
_RELATIVE, _RANK, _BLOB = 1e-6, 2, 0.4


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
    whole = isinstance(count, int | np.integer) and count >= 1
    require(whole, "count", repr(count), "a whole number above 0")
    size = np.asarray(sensor.size, float)
    margin = sensor.mean_pitch / 2
    given = [margin, margin, *(size - margin)] if region is None else region
    box = np.asarray(float_array("region", given), float)
    require(box.shape == (4,), "region", f"shape {box.shape}", "x0, y0, x1, y1")
    require_finite("region", jnp.asarray(box))
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
    where = float_array("places", places, sensor.dtype)
    require_shape("places", where, (None, 2))
    require(len(where) > 0, "places", "none", "one place at least")
    require_finite("places", where)
    if known(where):
        on = (np.asarray(where) >= 0) & (np.asarray(where) <= np.asarray(sensor.size))
        off = int((~on.all(1)).sum())
        require(off == 0, "places", f"{off} off the sheet", "places on it")
    for name, number in (("lam", lam), ("radius", radius), ("conductance", conductance)):
        if number is not None:
            require_positive(name, float_array(name, number))
    rigs = criterion == "rigs"
    fits = not rigs or method != "source"
    require(fits, "criterion", "'rigs' of 'source'", "another, or another method")
    given = noise is not None
    require(not (rigs and given), "noise", "a value for criterion 'rigs'", "none: rigs'")
    precision = None if noise is None else _precision(sensor, noise)
    metal = 1.0 if rigs and method == "linear" else 1e-4
    conductance = metal if conductance is None else conductance
    # Where its contacts are is what `points` alone needs to know closely.
    sheet = sheet_of(sensor) if method != "linear" else None
    if method == "points":
        assert sheet is not None
        contact = _contact(sheet, radius, conductance)
        if rigs:
            prior = place_prior(sheet.unit)
            return simulated_place_error(sensor, sheet, where, *contact, prior)
        noise = noise_of(sensor) if precision is None else precision
        return _of_points(sheet, where, criterion, noise, *contact)
    found = (Linear if method == "linear" else Source).of(sensor, (grid, grid))
    shares = None
    if sheet is not None:
        current = jax.vmap(
            jax.vmap(contact_current, (None, None, None, None, 0)),
            (None, 0, None, None, None),
        )
        size, resistance = _contact(sheet, radius, conductance)
        each = current(sheet, where, size, resistance, jnp.arange(found.electrode_count))
        shares = (each / each.mean(1, keepdims=True)) ** 2
    value = _RELATIVE * found.scale() if lam is None else lam
    if rigs:
        assert isinstance(found, Linear)
        disc = _DISC * sensor.mean_pitch if radius is None else radius
        return simulated_image(
            sensor, found, where, value, disc, conductance, sensor.mean_pitch
        )
    width = _BLOB * sensor.mean_pitch if radius is None else radius
    return image_objective(found, where, criterion, value, precision, width, shares)


def _precision(sensor: Sensor, noise: Numbers) -> Float[Array, "M M"]:
    """Returns N⁻¹ of the noise, 1/V²."""
    m = sensor.electrode_count
    given = float_array("noise", noise, sensor.dtype)
    require_shape("noise", given, (), (m,), (m, m))
    require_finite("noise", given)
    if given.ndim < 2:
        require_positive("noise", given)
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
    factors, basis = method.factors[..., :rank], method.basis[:rank]
    seen = factors
    if precision is not None:
        # λ keeps Eq. 3's unit: N relative to its mean variance.
        mean = jnp.mean(jnp.diagonal(jnp.linalg.inv(precision)))
        seen = jnp.einsum("mn,lnr->lmr", precision * mean, factors, precision="highest")
    grams = jnp.einsum("lmr,lms->lrs", factors, seen, precision="highest")
    columns = matmul(blobs(method.shape, method.cell, places, width), basis.T)
    columns = columns / jnp.linalg.norm(columns, axis=1, keepdims=True)
    if criterion == "d":
        columns = _span(columns)
    return ImageVariance(criterion, grams, columns, shares, jnp.asarray(lam, grams.dtype))


def _span(columns: Float[Array, "P r"]) -> Float[Array, "q r"]:
    """Returns orthonormal rows of the columns' span, for singular values above a tenth."""
    _, s, vt = np.linalg.svd(np.asarray(columns, float), full_matrices=False)
    return jnp.asarray(vt[s > 0.1 * s[0]], columns.dtype)


def _contact(
    sheet: Sheet, radius: float | None, conductance: float
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns a contact's size as `points` counts sizes, and the contact's resistance."""
    dtype = sheet.size.dtype
    usual = sheet.size if radius is None else jnp.asarray(radius, dtype)
    return jnp.log(usual / sheet.size) / SIZE_WIDTH, jnp.asarray(1 / conductance, dtype)


def _of_points(
    sheet: Sheet,
    places: Float[Array, "P 2"],
    criterion: str,
    noise: Noise | Float[Array, "M M"],
    size: Float[Array, ""],
    resistance: Float[Array, ""],
) -> PlaceInformation:
    """Makes the objective of `points`; `noise` is that of `points`, or N⁻¹."""
    m = len(sheet.field.electrodes)

    def one(place: Array, ground: Array) -> Float[Array, "3 3"]:
        columns = contact_columns(sheet, place, size, resistance, ground)
        if isinstance(noise, Noise):
            weights = slot_weights(noise, columns[0], jnp.ones(m, bool))
            seen = weighed(weights, columns)
        else:
            seen = matmul(columns, noise)
        gram = matmul(columns, seen.T)
        # The current is whatever fits: what it could explain says nothing of the place.
        return gram[1:, 1:] - gram[1:, :1] * gram[:1, 1:] / gram[0, 0]

    every = jax.vmap(one, (None, 0))
    each = jax.jit(lambda some: jax.lax.map(lambda x: every(x, jnp.arange(m)), some))
    return PlaceInformation(criterion, each(places), place_prior(sheet.unit), sheet.unit)


def place_prior(unit: Array) -> Float[Array, "3 3"]:
    """Returns the prior information on place (per unit) and size."""
    known = jnp.full_like(unit, 1 / _PLACE_KNOWN**2)
    return jnp.diag(jnp.stack([known, known, jnp.ones_like(known)]))


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
    sheet = sheet_of(sensor)
    size, resistance = _contact(sheet, radius, conductance)
    one = lambda x, g: contact_columns(sheet, x, size, resistance, g)[0]  # noqa: E731
    grounds = exploration(sensor)
    return jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))(places, grounds)
