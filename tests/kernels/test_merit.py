"""Figures of merit: closed forms, pyEIT's own on the same images, derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pyeit.quality import merit as pyeit_merit

from tomojax.kernels.images import (
    greit_figures,
    half_area_radius,
    half_width,
    image_error,
    image_place,
    pixel_places,
)

# Each is one compiled program here. JAX would else compile each of its operations alone.
greit_figures, half_area_radius, half_width, image_error, image_place = map(
    jax.jit, (greit_figures, half_area_radius, half_width, image_error, image_place)
)

CELL = jnp.array([0.002, 0.0025])


@partial(jax.jit, static_argnums=2)
def gaussian(at, sigma, shape=(80, 64), cell=CELL):
    x, y = pixel_places(shape, cell)
    away = (x[:, None] - at[0]) ** 2 + (y - at[1]) ** 2
    return jnp.exp(-away / (2 * sigma**2))


@pytest.mark.parametrize("at", [(0.081, 0.08125), (0.0834, 0.0761)])
def test_of_a_gaussian(at) -> None:
    """Half width σ√(2 ln 2), up to a third of a cell where the top is between pixels."""
    sigma = 0.02
    image = 3 * gaussian(at, sigma)
    half = sigma * np.sqrt(2 * np.log(2))
    assert abs(half_width(image, CELL) - half) < 1e-4
    assert abs(half_area_radius(image, CELL) - half) < 2e-4
    np.testing.assert_allclose(image_place(image, CELL), at, atol=2e-5)


def test_half_width_stops_at_the_edge() -> None:
    """σ = 20 mm, 5 mm from one side: that direction has 5 mm and no more."""
    image = gaussian((0.005, 0.08125), 0.02)
    half = 0.02 * np.sqrt(2 * np.log(2))
    assert abs(half_width(image, CELL) - (3 * half + 0.005) / 4) < 5e-4
    flat = half_width(jnp.ones((8, 4)), jnp.ones(2))
    assert flat == (8 + 4) / 4


def test_half_width_is_differentiable() -> None:
    f = lambda s: half_width(gaussian((0.081, 0.08125), s), CELL)  # noqa: E731
    slope = jax.jit(jax.grad(f))(0.02)
    np.testing.assert_allclose(slope, np.sqrt(2 * np.log(2)), rtol=0.02)
    np.testing.assert_allclose(slope, (f(0.02 + 1e-7) - f(0.02 - 1e-7)) / 2e-7, rtol=1e-6)
    place = jax.jit(jax.jacobian(lambda x: image_place(gaussian((x, 0.08), 0.02), CELL)[0]))
    np.testing.assert_allclose(place(0.081), 1, rtol=0.02)


def test_image_error() -> None:
    truth = gaussian((0.06, 0.06), 0.01)
    assert image_error(5 * truth, truth) < 1e-7
    assert image_error(-truth, truth) == 1
    far = gaussian((0.14, 0.14), 0.004)
    assert image_error(far, truth) > 0.999
    # Half of two equal, separate blobs: cos² = 1/2.
    other = gaussian((0.13, 0.13), 0.01)
    np.testing.assert_allclose(image_error(truth, truth + other), np.sqrt(0.5), rtol=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["round", "ringing", "bar", "noise"])
def test_greit_figures_are_pyeits(rng, kind, sign) -> None:
    """Square pixels of side 1, as pyEIT counts; its PE is a difference of distances from
    the first pixel, its RNG has the image's sign and its AR is the sum alone."""
    shape, cell = (40, 36), jnp.ones(2)
    blob = gaussian((17.3, 20.1), 4.0, shape, cell)
    image = {
        "round": lambda: blob,
        "ringing": lambda: blob - 0.4 * gaussian((27.0, 22.0), 5.0, shape, cell),
        "bar": lambda: blob + gaussian((23.0, 17.0), 3.0, shape, cell),
        "noise": lambda: blob + 0.1 * jnp.asarray(rng.standard_normal(shape)),
    }[kind]()
    target = (gaussian((18.0, 20.0), 4.0, shape, cell) > 0.5).astype(float)
    mine = greit_figures(sign * image, target, cell)
    theirs = pyeit_merit.calc_greit_figures_of_merit(
        np.asarray(target), np.asarray(sign * image)
    )
    np.testing.assert_allclose(mine.amplitude * target.sum(), theirs[0], rtol=1e-12)
    np.testing.assert_allclose(mine.resolution, theirs[2], rtol=1e-12)
    np.testing.assert_allclose(mine.shape_deformation, theirs[3], rtol=1e-12)
    np.testing.assert_allclose(mine.ringing, -theirs[4], rtol=1e-10, atol=1e-12)
    assert mine.ringing >= 0
    # pyEIT's own centres, half a pixel from ours.
    quarter = pyeit_merit.calc_fractional_amplitude_set(np.asarray(sign * image))
    centres = [np.argwhere(a).mean(0) for a in (np.nan_to_num(quarter) > 0, target > 0)]
    np.testing.assert_allclose(
        mine.position_error, np.linalg.norm(centres[0] - centres[1]), rtol=1e-10
    )
    distances = [np.linalg.norm(c) for c in centres]
    np.testing.assert_allclose(distances[1] - distances[0], theirs[1], rtol=1e-10)


def test_batched(rng) -> None:
    images = jnp.stack([gaussian((0.05, 0.07), 0.01), gaussian((0.1, 0.07), 0.02)])
    many = jax.vmap(lambda i: greit_figures(i, images[0], CELL))(images)
    one = greit_figures(images[1], images[0], CELL)
    for a, b in zip(many, one):
        np.testing.assert_allclose(a[1], b, rtol=1e-12)
