"""Turns a frame and a Jacobian into an image: the paper's linear reconstruction (Eq. 3)."""

from typing import cast, get_args, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax._checks import (
    checked,
    float_array,
    known,
    require,
    require_array,
    require_indices,
    require_shape,
)
from tomojax._custom_types import Numbers
from tomojax._require import require_whole
from tomojax._shown import tuple_shown
from tomojax.kernels import inverse
from tomojax.kernels.algebra import matmul
from tomojax.kernels.flags import Flag


class Reconstruction(NamedTuple):
    """Images of one frame, or of a batch with a leading axis.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
    >>> result = tx.reconstruct(tx.jacobian(sensor, [0, 15]), volts)
    >>> tx.paper.pixels(sensor, result.image).shape
    (16, 16)
    >>> bool(result.residual < volts.max()), int(result.flags)
    (True, 0)
    """

    image: Float[Array, "*frames K"]  # φ per element, V; NaN where it cannot be solved
    lam: Float[Array, "*frames"]  # λ that was used
    residual: Float[Array, "*frames"]  # rms of Jφ − V over the rows used, V
    flags: Int[Array, "*frames"]  # bits of `Flag`; 0 is good

    def __repr__(self) -> str:
        return tuple_shown(self, image=("V", 1.0), residual=("V", 1.0))


def reduce_jacobian(jacobian: Numbers, rank: int = 256) -> inverse.ReducedSlots:
    """Reduces J to an orthonormal basis of `rank` rows: a new λ then costs a millisecond.

    New grounds cost as little. `rank` 256 holds J(0) of the paper's sensor to 8e-4 of its
    norm. An image then differs from the full one by 2e-4 at λ = 2.5e-3·σ₁², and by 7e-3 at
    1e-6·σ₁².
    **Raises:** `ValueError` for a rank outside 1 to the number of rows and columns.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> reduced = tx.paper.reduce_jacobian(tx.jacobian(sensor, [0, 15]), rank=24)
    >>> reduced.factors.shape, reduced.basis.shape
    ((2, 16, 24), (24, 512))
    >>> volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
    >>> tx.reconstruct(reduced, volts[:1], [0], lam=0.1).image.shape  # one of the slots
    (512,)
    """
    array = float_array("jacobian", jacobian)
    require_shape("jacobian", array, (None, None, None))
    require_whole("rank", rank, 1, min(array.shape[0] * array.shape[1], array.shape[2]))
    return _reduce(array, rank)


@eqx.filter_jit
def _reduce(jacobian: Array, rank: int) -> inverse.ReducedSlots:
    return inverse.reduce_slots(jacobian, inverse.row_basis(jacobian, rank))


def reconstruct(
    jacobian: Numbers | inverse.ReducedSlots,
    voltages: Numbers,
    grounds: Numbers | None = None,
    *,
    lam: Numbers | inverse.LambdaRule = "cautious",
    weights: Numbers | None = None,
    noise: Numbers | None = None,
    per_recording: bool = False,
    route: inverse.SolveRoute = "auto",
) -> Reconstruction:
    """Computes φ = (J_sᵀWJ_s + λI)⁻¹J_sᵀWV_s, the paper's Eq. 3, with λ given or chosen.

    **Arguments:**

    - `jacobian` (L, M, K): any, such as `tomojax.jacobian`; or `reduce_jacobian` of one.
    - `voltages` (S, M), or a batch (frames, S, M), V. `volts[np.asarray(grounds)]` takes
      the voltages of some grounds from all.
    - `grounds` (S,): which of the L slots of `jacobian` were read; None: all slots.
    - `lam`: λ > 0 in the unit of J², or a rule of `lambda_scores`. The default needs no
      noise level and stands gain errors and common-mode noise. Under these, GCV and the
      marginal likelihood choose a λ decades too small. A rule takes the SVD of the selected
      rows (half a second for eight slots). So reduce the Jacobian for many slots, and give
      a stream the λ of its first frames.
    - `weights` ≥ 0, (S,) per slot or (S, M) per voltage: 0 leaves a slot or voltage out (a
      voltage left out may be NaN).
    - `noise`: V rms of the white noise, for "discrepancy" alone.
    - `per_recording`: one λ for the whole batch.
    - `route`: "auto" solves in float64, whatever the dtype of J. "cholesky" solves in J's
      dtype, for a device without float64. In float32 "cholesky" serves λ from 1e-5·σ₁² up.
      Below that λ it loses digits. Below 1e-7·σ₁² its image is NaN, and flagged
      SOLVE_FAILED.

    **Returns:** `Reconstruction`. Under a trace values are not known; there a flag and an
    image of NaN replace an error. A rule sets BAD_LAMBDA, and leaves the image, where
    it chose the largest λ of its search: such voltages are noise to the rule.
    **Raises:** `ValueError` for shapes that do not fit, NaN voltages, empty or repeated
    grounds, λ ≤ 0, an unknown rule, or "discrepancy" without `noise`.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
    >>> result = tx.reconstruct(tx.jacobian(sensor, [0, 15]), volts)  # or lam=0.1
    >>> result.image.shape, bool(result.lam > 0), int(result.flags)
    ((512,), True, 0)
    """
    reduced = isinstance(jacobian, inverse.ReducedSlots)
    slots = jacobian if reduced else float_array("jacobian", cast(Numbers, jacobian))
    maps = slots.factors if isinstance(slots, inverse.ReducedSlots) else slots
    require_shape("jacobian", maps, (None, None, None))
    chosen = _slots(grounds, len(maps))
    shape = (len(chosen), maps.shape[1])
    v = float_array("voltages", voltages, maps.dtype)
    all_slots = v.shape[-2:] == maps.shape[:2] and v.shape[-2:] != shape
    hint = f"shape {shape}: voltages[np.asarray(grounds)], those of the grounds alone"
    require(not all_slots, "voltages", f"shape {v.shape}, all {len(maps)} slots", hint)
    require_shape("voltages", v, shape, (None, *shape))
    given = np.ones(shape[:1]) if weights is None else weights
    shapes, dtype = (shape[:1], shape), maps.dtype
    given = checked("weights", given, "not negative", *shapes, dtype=dtype)
    if known(given):
        require(np.asarray(given).any(), "weights", "all 0", "a weight above 0")
    per_row = given if given.ndim == 2 else given[:, None]
    w = jnp.broadcast_to(per_row, shape)
    if known(v, w):
        require_array("voltages", jnp.where(w > 0, v, 0), "finite")
    rules, routes = get_args(inverse.LambdaRule), get_args(inverse.SolveRoute)
    require(route in routes, "route", repr(route), f"one of {', '.join(routes)}")
    rule = None
    if isinstance(lam, str):
        require(lam in rules, "lam", repr(lam), f"a number or one of {', '.join(rules)}")
        rule, lam = lam, 1.0
    value = checked("lam", lam, "positive", (), v.shape[:-2], dtype=dtype)
    missing = rule == "discrepancy" and noise is None
    require(not missing, "noise", None, "V rms for the rule 'discrepancy'")
    sigma = 1.0 if noise is None else noise
    sigma = checked("noise", sigma, "positive", (), dtype=dtype)
    # Blocks that add over slots: for weights that do, in the dtype that holds them.
    additive = reduced and given.ndim == 1 and maps.dtype == jnp.float64
    blocks = additive and route == "auto"
    return _reconstruct(
        slots, v, chosen, value, w, sigma, rule, per_recording, None if blocks else route
    )


def _slots(grounds: Numbers | None, count: int) -> Int[Array, " S"]:
    if grounds is None:
        return jnp.arange(count)
    if known(grounds):
        kind = np.asarray(grounds).dtype.kind
        require(kind in "iu", "grounds", repr(grounds), "numbers of slots, at least one")
    array = jnp.asarray(grounds)
    require_indices("grounds", array, count)
    if known(array):
        twice = array.size - len(np.unique(np.asarray(array)))
        require(not twice, "grounds", f"{twice} repeated", "each at most once")
    return array


@eqx.filter_jit
def _reconstruct(
    slots, voltages: Array, grounds, lam, w, noise, rule, per_recording, route
):
    reduced = isinstance(slots, inverse.ReducedSlots)
    maps = slots.factors if reduced else slots
    rows = maps[grounds]
    # What has no weight may be anything.
    v: Array = jnp.where(w > 0, voltages, 0)
    frames = v if v.ndim == 3 else v[None]
    ran_out = jnp.zeros(lam.shape, bool)
    if rule is not None:
        shared = per_recording or v.ndim == 2
        lam, ran_out = _chosen_lambda(rows, frames, w, noise, rule, shared)

    def one(frame: Array, lam: Array, ran_out: Array) -> Reconstruction:
        if route is None:
            solution = inverse.solve_reduced(slots, grounds, frame, lam, w[:, 0])
        else:
            flat = rows.reshape(-1, rows.shape[-1])
            solution = inverse.tikhonov(flat, frame.ravel(), lam, w.ravel(), route)
        misfit = jnp.einsum("smk,k->sm", rows, solution, precision="highest") - frame
        residual = jnp.sqrt(jnp.mean(misfit**2, where=w > 0))
        # A GPU rounds products to TF32 otherwise: images off by 3e-4.
        image = matmul(solution, slots.basis) if reduced else solution
        flags = _flags(frame, lam, grounds, len(maps), w, image)
        image = jnp.where(flags == 0, image, jnp.nan)
        flags = flags | jnp.where(ran_out, Flag.BAD_LAMBDA.value, 0)
        return Reconstruction(image, lam, residual, flags)

    if v.ndim == 2:
        return one(v, lam, ran_out)
    if lam.ndim == 0:  # one factor serves all frames
        return jax.vmap(one, (0, None, None))(frames, lam, ran_out)
    return jax.lax.map(lambda each: one(*each), (frames, lam, ran_out))


def _chosen_lambda(
    rows, frames, w, noise, rule, shared
) -> tuple[Float[Array, "*frames"], Bool[Array, "*frames"]]:
    """λ, and whether that is the largest of the search."""
    scale = jnp.sqrt(w)
    s = inverse.spectrum(scale[..., None] * rows)
    grid = inverse.lambda_grid(s)
    score = lambda frame: inverse.lambda_scores(s, scale * frame, grid, rule, noise)  # noqa: E731
    scores = jax.lax.map(score, frames)
    if shared:
        lam = inverse.choose_lambda(grid, scores)
    else:
        lam = jax.vmap(lambda one: inverse.choose_lambda(grid, one))(scores)
    return lam, lam >= grid[-1]


def _flags(frame, lam, grounds, count, w, image) -> Int[Array, ""]:
    same = (grounds[:, None] == grounds).sum() > len(grounds)
    outside = ((grounds < 0) | (grounds >= count)).any()

    def bit(bad: Bool[Array, ""], flag: Flag) -> Array:
        return jnp.where(bad, flag.value, 0)

    bad = (
        bit(~jnp.isfinite(frame).all(), Flag.BAD_VOLTAGES)
        | bit(~(lam > 0), Flag.BAD_LAMBDA)
        | bit(same | outside | ~(w > 0).any(), Flag.BAD_GROUNDS)
    )
    failed = (bad == 0) & ~jnp.isfinite(image).all()
    return bad | bit(failed, Flag.SOLVE_FAILED)
