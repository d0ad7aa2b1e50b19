"""Models contacts about as long as wide: the voltages they make in a frame, and slopes.

Slopes are the table's own derivatives, whitened, and added up to normal equations slot by
slot. A contact's current leans to one side, depending on the contact's place, radius and
current, and on the other contacts. The slopes include place and radius only; so the
gradient of a large metal contact is slightly off.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.algebra import Limits
from tomojax.kernels.contacts._equations import (
    best_currents,
    currents_of,
    Explained,
    made_by,
    whitened_rows,
    WhitenedFrame,
)
from tomojax.kernels.contacts._field import home_of, rows_at
from tomojax.kernels.contacts._points import (
    DISC,
    drops,
    Fitted,
    green_of,
    LEAST_DROP,
    LONG,
    longness,
    not_beyond,
    polarisability,
    Sheet,
    SIZE_WIDTH,
    slope_of,
    unpack,
)

# The longest step of each parameter of a disc. Places in units of the fit (a twentieth of
# a pitch): a start is no farther off than a candidate from its neighbour. A size and
# lengths may not run away while the place is still wrong.
_LONGEST = 6.0, 6.0, 0.7, 1.0, 1.0, 1.0


def discs(sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, " P"]) -> Explained:
    """Explains a frame by contacts about as long as wide; each leans as metal does.

    A disc of radius a is polarised if its contact conducts better than the sheet below. The
    current's centre then moves by 2πa²κ/ρ·E/I, κ = I₂/I₀(√(gρ/π)) from 0 to 1.
    """
    parameters = parameters.reshape(-1, DISC)
    count = len(parameters)
    place, radius = unpack(sheet, parameters)
    moment = LONG * sheet.size**2 * parameters[:, 3:5]
    rows = jax.vmap(rows_at, (None, 0, 0, 0))(sheet.field, place, radius, moment)
    columns, whitened = _columns(sheet, frame, rows)
    alone = whitened[:, :count]
    each = whitened[:, count:].reshape(len(whitened), count, 7, -1)
    current = currents_of(alone, frame.whitened)
    flowing = made_by(current, columns[:, :count])
    at_grounds = sheet.slots.sunk(rows, frame.grounds, flowing)  # (C, 8, S)
    level = sheet.slots.level(rows[:, 0], frame.grounds).T
    steep = slope_of(sheet, place, radius)
    among = jax.vmap(green_of(sheet, place, radius))(place)
    within = _within(sheet, place, radius)

    def leaning(moved: Array, slope: Array) -> tuple[Array, Array]:
        # A rim's own potential falls with ln of its radius; outside it does not change.
        near = among - within * (moved / radius - 1)
        sunk = at_grounds[:, 0].T
        drop = drops(sheet, frame.grounds, near, level, sunk, current)
        towards = current.sum(1)[:, None, None] * slope.transpose(2, 0, 1)
        pull = jnp.einsum("sd,cdk->sck", current, steep, precision="highest")
        return _lean(sheet, moved, current, drop, towards - pull), drop

    now = radius, at_grounds[:, 1:3]
    turned = jax.vmap(lambda *t: jax.jvp(leaning, now, t), out_axes=(None, 0))
    (shift, drop), (by, _) = turned(*_moving(radius, at_grounds))
    moves = jnp.concatenate([shift[None], by])  # and by x, y and radius
    moves = jnp.einsum("dsck,sckw->dscw", moves, each[:, :, :2], precision="highest")
    column = alone + moves[0]
    current, rest = best_currents(column, frame.whitened)
    first = each[:, :, :3] + moves[1:].transpose(1, 2, 0, 3) + _bent(shift, each)
    each = jnp.concatenate([first, each[:, :, 3:5], 0 * first[:, :, :1]], 2)
    scale = current[:, :, None] * chain_of(sheet, parameters, radius)
    tangent = (each * scale[..., None]).reshape(len(drop), -1, each.shape[-1])
    prior, by_parameter = priors_of(parameters)
    moved = columns[:, count:].reshape(len(drop), count, 7, -1)[:, :, :2]
    moved = jnp.einsum("sck,sckm->scm", shift, moved, precision="highest")
    volts = made_by(current, columns[:, :count] + moved)
    none = jnp.zeros_like(place)
    at = jax.vmap(home_of, (None, 0))(sheet.field, place)
    fitted = Fitted(at, none, none[:, 0], radius, current, drop, volts)
    return Explained(rest, column, tangent, prior, by_parameter, fitted)


def limits_of(sheet: Sheet) -> Limits:
    """Returns limits: a disc is at most the table's largest disc. See `_LONGEST`."""
    largest = jnp.log(sheet.field.radii[-1] / sheet.size) / SIZE_WIDTH
    highest = jnp.where(jnp.arange(DISC) == 2, largest, jnp.inf)
    return Limits(highest, jnp.asarray(_LONGEST, highest.dtype))


def _moving(radius: Float[Array, " C"], at: Float[Array, "C 8 S"]) -> tuple[Array, Array]:
    """Returns tangents of radii and of slopes at the grounds, by x, y and radius.

    R is harmonic: R_xx = −R_yy = (R_xx − R_yy)/2.
    """
    unlike, mixed = at[:, 4], at[:, 5]
    slopes = [[unlike, mixed], [mixed, -unlike], [at[:, 6], at[:, 7]]]
    none = jnp.zeros_like(radius)
    one = jnp.stack([none, none, none + 1])
    return one, jnp.stack([jnp.stack(pair, 1) for pair in slopes])


def _bent(
    shift: Float[Array, "S C 2"], each: Float[Array, "S C 7 W"]
) -> Float[Array, "S C 3 W"]:
    """Computes slopes of s·∇R by x, y and radius; the shift s stays as it is."""
    x, y = shift[..., :1], shift[..., 1:]
    unlike, mixed = each[:, :, 3], each[:, :, 4]
    by_radius = x * each[:, :, 5] + y * each[:, :, 6]
    return jnp.stack([x * unlike + y * mixed, x * mixed - y * unlike, by_radius], 2)


def _columns(
    sheet: Sheet, frame: WhitenedFrame, rows: Float[Array, "C 8 M"]
) -> tuple[Float[Array, "S R M"], Float[Array, "S R W"]]:
    """Computes each disc's volts per ampere, then their derivatives; whitened too."""
    count, _, m = rows.shape
    flat = jnp.concatenate([rows[:, 0], rows[:, 1:].reshape(-1, m)])
    offset = sheet.slots.offset(frame.grounds)
    level = jnp.where(jnp.arange(len(flat))[:, None] < count, offset[:, None], 0)
    columns = jnp.moveaxis(sheet.slots.relative(flat, frame.grounds), 1, 0) + level
    return columns, whitened_rows(frame, columns)


def chain_of(
    sheet: Sheet, parameters: Float[Array, "C 6"], radius: Float[Array, " C"]
) -> Float[Array, "C 6"]:
    """Computes derivatives of place, radius and moments by the underlying parameters."""
    size, raw = sheet.field.size, parameters[:, :2] * sheet.unit
    mirrored = jnp.where(jnp.abs(raw) % (2 * size) > size, -1, 1) * jnp.sign(raw)
    by_size = SIZE_WIDTH * radius
    long = jnp.broadcast_to(LONG * sheet.size**2, raw.shape)
    each = mirrored * sheet.unit, by_size[:, None], long, 0 * by_size[:, None]
    return jnp.concatenate(each, 1)


def priors_of(
    parameters: Float[Array, "C 6"], told: Float[Array, " C"] | None = None
) -> tuple[Array, Array]:
    """Measures sizes, lengths and conductances against their priors; returns slopes too.

    `told`: how well a conductance is told by its contact's mean potential, 1/σ; 1 of discs.
    """
    told = jnp.ones_like(parameters[:, 0]) if told is None else told

    def one(p: Float[Array, "6"], told: Float[Array, ""]) -> Float[Array, "4"]:
        return jnp.concatenate([p[2:3], longness(p[3:5]), told * p[5:6]])

    values = jax.vmap(one)(parameters, told)
    slopes = jax.vmap(jax.jacfwd(one))(parameters, told)
    count = len(parameters)
    whole = jnp.eye(count, dtype=slopes.dtype)[:, None, :, None] * slopes[:, :, None]
    return values.ravel(), whole.reshape(values.size, -1)


def _within(
    sheet: Sheet, place: Float[Array, "C 2"], radius: Float[Array, " C"]
) -> Float[Array, "C C"]:
    """Returns ρ/2π where a place lies within another disc's rim, or its own; else 0."""
    rim = radius * float(np.exp(-0.25))
    square = ((place[:, None] - place) ** 2).sum(-1)
    return jnp.where(square < rim**2, sheet.sheet_resistance / (2 * np.pi), 0)


def _lean(
    sheet: Sheet,
    radius: Float[Array, " C"],
    current: Float[Array, "S C"],
    drop: Float[Array, "S C"],
    pull: Float[Array, "S C 2"],
) -> Float[Array, "S C 2"]:
    """Computes the distance from each contact's middle to the middle of its current, m."""
    least = LEAST_DROP * jnp.abs(sheet.drive_voltage)
    forward = jnp.sign(sheet.drive_voltage)
    mean_drop = jnp.maximum((forward * drop).mean(0), least)
    flowing = jnp.maximum((forward * current).mean(0), 0)
    moment = polarisability(sheet, flowing / mean_drop, radius)
    enough = 1e-4 * jnp.abs(current).sum(1, keepdims=True) + 1e-15
    safe = jnp.where(jnp.abs(current) > enough, current, jnp.inf)
    return not_beyond(moment[:, None] * pull / safe[..., None], radius)
