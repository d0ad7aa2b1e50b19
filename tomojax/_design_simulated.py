"""Designs by simulation: the error of images of contacts on rigs that are not nominal.

What reconstructs knows nominal values; the voltages are of sheets that vary, electrodes
off their places, channels with gains and noise. Not convex in the weights, so there is no
bound; λ and the length over which an image is smooth are found together with the grounds.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from tomojax._checks import require_shape
from tomojax._design_contacts import blobs
from tomojax._design_objectives import AbstractObjective
from tomojax._design_rigs import Scenes
from tomojax._linear import Linear
from tomojax._source import Source
from tomojax.kernels._blocktri import matmul
from tomojax.kernels._positive import gaussian
from tomojax.kernels._subsets import draw_subset, drawn_weights, heaviest

# Sets that are drawn in the end.
_LAST = 64

# Decades of λ on both sides that are tried at first, and steps from the best of them.
_DECADES, _STEPS = 3, 12

# How often a search is gone on with; the least λ, of what is rounded off the slots' sum.
_SCANS, _LEAST = 4, 1e-3

# Of λ/σ₁², where the search for λ begins.
_FIRST = 1e-5


class ImageError(AbstractObjective):
    """1 − cos² of the angle between each scene's image and a Gaussian at its contact.

    φ = GGᵀBᵀc, Tikhonov's under a prior that is smooth over ℓ (G a Gaussian), of the slots
    with their weights; differentiable in the weights, ln λ and ln ℓ, by the rule of the
    linear solve. 0 is an image like the contact, 1 one that has nothing of it.
    """

    grams: Float[Array, "L r r"]
    rights: Float[Array, "P L r"]  # A_lᵀv_l of each scene
    basis: Float[Array, "r pixels"]
    targets: Float[Array, "P pixels"]
    log_lam: Float[Array, ""]
    log_length: Float[Array, ""] | None  # in pixels; None: no smoothing
    shape: tuple[int, int] = eqx.field(static=True)
    worst: ClassVar[bool] = False  # pyright: ignore
    convex: ClassVar[bool] = False
    unit: ClassVar[str] = "1"  # pyright: ignore

    @classmethod
    def of(
        cls, method: Linear | Source, scenes: Scenes, width: float, smooth: bool = False
    ) -> "ImageError":
        """Through the images of `method`; contacts are Gaussians of `width` (σ), m."""
        rank = 128
        factors, basis = method.factors[..., :rank], method.basis[:rank]
        grams = jnp.einsum("lmr,lms->lrs", factors, factors, precision="highest")
        count, m = len(factors), method.electrode_count
        require_shape("voltages", scenes.voltages, (None, count, m))
        rights = jnp.einsum("lmr,plm->plr", factors, scenes.voltages, precision="highest")
        places = scenes.places.reshape(-1, 2)
        targets = blobs(method.shape, method.cell, places, width)
        targets = targets.reshape(len(scenes.places), -1, targets.shape[1]).sum(1)
        targets = targets / jnp.linalg.norm(targets, axis=1, keepdims=True)
        lam = jnp.log(jnp.asarray(_FIRST * method.scale(), basis.dtype))
        length = jnp.zeros((), basis.dtype) if smooth else None
        return cls(grams, rights, basis, targets, lam, length, method.shape)

    @property
    def slots(self) -> int:
        return len(self.grams)

    @property
    def lam(self) -> float:
        return float(jnp.exp(self.log_lam))

    def alone(self, k: Array) -> "ImageError":
        k = jnp.atleast_1d(k)
        return replace(self, rights=self.rights[k], targets=self.targets[k])

    def images(self, weights: Float[Array, " L"]) -> Float[Array, "P pixels"]:
        """φ of every scene, from one set of slots."""
        return self.images_of(weights, self.rights)

    def images_of(self, weights: Array, rights: Array) -> Float[Array, "P pixels"]:
        total = jnp.einsum("l,lrs->rs", weights, self.grams, precision="highest")
        right = jnp.einsum("l,plr->rp", weights, rights, precision="highest")
        if self.log_length is None:
            return matmul(self._solved(total, right).T, self.basis)
        sides = [gaussian(n, jnp.exp(self.log_length)) for n in self.shape]
        sides = [side / jnp.linalg.norm(side, axis=1, keepdims=True) for side in sides]
        smooth = self._smoothed(self.basis, sides)
        inner = matmul(smooth, smooth.T)
        eps = 64 * jnp.finfo(inner.dtype).eps * jnp.trace(inner)
        lower = jnp.linalg.cholesky(inner + eps * jnp.eye(len(inner), dtype=inner.dtype))
        turned = matmul(lower.T, matmul(total, lower))
        solution = self._solved(turned, matmul(lower.T, right))
        back = jax.scipy.linalg.solve_triangular(lower, solution, lower=True, trans="T")
        return self._smoothed(matmul(back.T, smooth), [side.T for side in sides])

    def _smoothed(self, images: Array, sides: Sequence[Array]) -> Array:
        grid = images.reshape(-1, *self.shape)
        smooth = jnp.einsum("pxy,xi,yj->pij", grid, *sides, precision="highest")
        return smooth.reshape(images.shape)

    def _solved(self, total: Array, right: Array) -> Array:
        unit = jnp.eye(len(total), dtype=total.dtype)
        system = total + jnp.exp(self.log_lam) * unit
        return jax.scipy.linalg.solve(system, right, assume_a="pos")

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        images = self.images(weights)
        alike = (images * self.targets).sum(1) ** 2
        return 1 - alike / ((images**2).sum(1) + jnp.finfo(images.dtype).tiny)


def _in_reach(objective: ImageError) -> ImageError:
    """With a λ that a way leads from: beyond these images are rounding, or 0."""
    total = jnp.trace(objective.grams.sum(0))
    low = _LEAST * jnp.finfo(objective.dtype).eps * total
    log_lam = jnp.clip(objective.log_lam, jnp.log(low), jnp.log(total))
    return replace(objective, log_lam=log_lam)


class Tuned(NamedTuple):
    """An objective with its best λ and length, and how many it took."""

    objective: ImageError
    value: Float[Array, ""]
    solves: int  # systems that were solved, one with its gradient counting as two


def tune(objective: ImageError, weights: Float[Array, " L"]) -> Tuned:
    """The λ (and length) of least mean error.

    The best λ of a few, a decade apart, about the one that it has (and on, while the best
    is the last of them); from there BFGS.
    """
    objective = _in_reach(objective)

    def value(parameters: tuple, rest: tuple) -> tuple[Array, Array]:
        log_lam, log_length = parameters
        one, weights = rest
        now = replace(one, log_lam=log_lam, log_length=log_length)
        return now.value(weights), jnp.zeros(())

    apart = jnp.arange(-_DECADES, _DECADES + 1, dtype=objective.dtype)
    middle, length = objective.log_lam, objective.log_length
    rest = objective, weights
    coarse = jax.jit(
        lambda r, some: jax.lax.map(lambda lam: value((lam, length), r)[0], some)
    )
    scans, best = 0, -1
    while scans < _SCANS and best in (-1, 0, len(apart) - 1):
        lams = middle + float(np.log(10)) * apart
        # What is no number is no minimum.
        best = int(jnp.argmin(jnp.nan_to_num(coarse(rest, lams), nan=jnp.inf)))
        middle, scans = lams[best], scans + 1
    solver = optimistix.BFGS(rtol=1e-3, atol=1e-3)
    found = optimistix.minimise(
        value,
        solver,
        (middle, length),
        rest,
        has_aux=True,
        max_steps=_STEPS,
        throw=False,
    )
    log_lam, log_length = found.value
    best = replace(objective, log_lam=log_lam, log_length=log_length)
    solves = scans * len(apart) + 2 * int(found.stats["num_steps"])
    return Tuned(best, best.value(weights), solves)


class Drawn(NamedTuple):
    """What `descend_sets` arrives at."""

    weights: Float[Array, " L"]
    logits: Float[Array, " L"]
    objective: ImageError


def descend_sets(
    objective: ImageError,
    n: int,
    *,
    steps: int = 200,
    draws: int = 4,
    rate: float = 0.2,
    seed: int = 0,
) -> Drawn:
    """Sets of `n` slots and λ together, by gradients through sets that are drawn.

    Sets come from `subset_marginals`' distribution, gradients by SIMPLE (`drawn_weights`),
    steps by Adam (Kingma and Ba, ICLR 2015). Ends with the best of some last ones.
    """
    objective = _in_reach(objective)
    logits = jnp.zeros(objective.slots, objective.log_lam.dtype)

    def value(parameters: tuple[Array, Array], keys: Array) -> Array:
        logits, log_lam = parameters
        now = replace(objective, log_lam=log_lam)
        one = lambda key: now.value(drawn_weights(key, logits, n))  # noqa: E731
        return jax.vmap(one)(keys).mean()

    def step(state: tuple, key: Array) -> tuple[tuple, None]:
        parameters, mean, square, k = state
        slope = jax.grad(value)(parameters, jax.random.split(key, draws))
        mean = jax.tree.map(lambda m, s: 0.9 * m + 0.1 * s, mean, slope)
        square = jax.tree.map(lambda q, s: 0.99 * q + 0.01 * s**2, square, slope)

        def moved(p: Array, m: Array, q: Array) -> Array:
            return p - rate * (m / (1 - 0.9**k)) / (jnp.sqrt(q / (1 - 0.99**k)) + 1e-12)

        return (jax.tree.map(moved, parameters, mean, square), mean, square, k + 1), None

    start = logits, objective.log_lam
    nothing = jax.tree.map(jnp.zeros_like, start)
    keys = jax.random.split(jax.random.key(seed), steps)
    first = start, nothing, nothing, jnp.ones((), logits.dtype)
    (logits, log_lam), *_ = jax.jit(lambda f, k: jax.lax.scan(step, f, k)[0])(first, keys)
    now = replace(objective, log_lam=log_lam)
    keys = jax.random.split(jax.random.key(seed), _LAST)
    sets = (
        jax.vmap(lambda key: draw_subset(key, logits, n))(keys)
        .at[0]
        .set(heaviest(logits, n))
    )
    values = jax.jit(lambda o, w: jax.lax.map(o.value, w))(now, sets)
    return Drawn(sets[jnp.argmin(values)], logits, now)
