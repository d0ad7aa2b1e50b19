"""Contacts of images whose contacts are known."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tomojax.kernels.images import find_peaks, read_contacts

CELL = np.array([0.005, 0.004])
SHAPE = (32, 40)


def blob(x, y, width=0.012, height=1.0, long=1.0, angle=0.0):
    """A Gaussian at (x, y) m, `long` times as wide along `angle`."""
    u, v = (np.indices(SHAPE) + 0.5) * CELL[:, None, None] - np.array([x, y])[:, None, None]
    along = (u * np.cos(angle) + v * np.sin(angle)) / long
    across = -u * np.sin(angle) + v * np.cos(angle)
    return height * np.exp(-(along**2 + across**2) / (2 * width**2))


@partial(jax.jit, static_argnames=("count", "level", "at_peak", "reach"))
def _read(image, cell, **options):
    return read_contacts(image, image, cell, **options)


def read(image, count=4, dtype=np.float64, **options):
    return _read(
        jnp.asarray(image, dtype), jnp.asarray(CELL, dtype), count=count, **options
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_one_round_contact(dtype):
    found = read(blob(0.0723, 0.0911), dtype=dtype)
    assert int(found.count) == 1 and found.xy.dtype == dtype
    np.testing.assert_allclose(found.xy[0], [0.0723, 0.0911], atol=1e-4)
    assert np.isnan(found.angle[0]) and np.isnan(np.asarray(found.xy[1:])).all()
    np.testing.assert_allclose(found.current[0], blob(0.0723, 0.0911).sum(), rtol=1e-5)


def test_radius_is_that_of_a_disc():
    """Of a disc's own image, to the pixels' blur."""
    u, v = (np.indices(SHAPE) + 0.5) * CELL[:, None, None]
    disc = ((u - 0.08) ** 2 + (v - 0.08) ** 2 < 0.03**2) * 1.0
    found = read(disc, level=0.5, at_peak=False)
    np.testing.assert_allclose(found.radius[0], 0.03, rtol=0.03)
    np.testing.assert_allclose(found.xy[0], [0.08, 0.08], atol=5e-4)


@pytest.mark.parametrize("degrees", [0, 30, 80, 90, 135, 170])
def test_direction_of_a_long_contact(degrees):
    angle = np.deg2rad(degrees)
    found = read(blob(0.08, 0.08, long=2.5, angle=angle))
    apart = (np.asarray(found.angle[0]) - angle + np.pi / 2) % np.pi - np.pi / 2
    assert abs(apart) < np.deg2rad(1.5)


def test_several_contacts_strongest_first():
    image = blob(0.03, 0.03) + blob(0.12, 0.05, height=0.7, width=0.016) + blob(0.08, 0.13)
    found = read(image)
    assert int(found.count) == 3
    current = np.asarray(found.current[:3])
    assert (np.diff(current) <= 0).all()
    np.testing.assert_allclose(current.sum(), image.sum(), rtol=1e-6)
    want = {(0.03, 0.03), (0.12, 0.05), (0.08, 0.13)}
    for place in np.asarray(found.xy[:3]):
        assert min(np.hypot(*(place - w)) for w in want) < 1e-3


def test_peaks_without_a_saddle_are_one_contact():
    """A bar over three electrodes; its place is its middle."""
    image = sum(blob(x, 0.08, width=0.011) for x in (0.05, 0.075, 0.1))
    ripple = 1 + 0.05 * np.cos(2 * np.pi * np.arange(SHAPE[0]) * CELL[0] / 0.025)
    found = read(image * ripple[:, None])
    assert int(found.count) == 1
    np.testing.assert_allclose(found.xy[0], [0.075, 0.08], atol=2e-3)
    assert min(float(found.angle[0]), np.pi - float(found.angle[0])) < 0.05


def test_peaks_at_corners_of_an_odd_image():
    """Squares of 2 × 2 pixels end where the image does."""
    image = np.zeros((7, 9))
    image[0, 0], image[6, 8], image[3, 4] = 1.0, 0.9, 0.8
    peaks = jax.jit(find_peaks, static_argnames="count")(jnp.asarray(image), count=4)
    assert list(zip(peaks.i[:3].tolist(), peaks.j[:3].tolist())) == [(0, 0), (6, 8), (3, 4)]
    np.testing.assert_allclose(peaks.height, [1.0, 0.9, 0.8, -np.inf])
    assert peaks.group.tolist() == [0, 1, 2, 4]


def test_nothing():
    for image in (np.zeros(SHAPE), -np.ones(SHAPE)):
        found = read(image)
        assert int(found.count) == 0
        assert all(np.isnan(np.asarray(a)).all() for a in found[1:])
    assert int(read(blob(0.08, 0.08), lowest=1.5).count) == 0


def test_a_batch_is_its_frames(rng):
    """The rule for batches, with frames of no, one and several contacts."""
    places = rng.uniform(0.02, 0.13, (150, 3, 2))
    images = np.stack(
        [
            sum(blob(*p) for p in some[: k % 4]) + 0 * blob(0, 0)
            for k, some in enumerate(places)
        ]
    )
    batch = jax.vmap(lambda z: _read(z, jnp.asarray(CELL), count=4))(jnp.asarray(images))
    alone = [read(z) for z in images]
    np.testing.assert_array_equal(batch.count, [a.count for a in alone])
    for name in ("xy", "radius", "angle", "current"):
        want = np.stack([np.asarray(getattr(a, name)) for a in alone])
        np.testing.assert_allclose(getattr(batch, name), want, rtol=1e-9, atol=1e-12)
    assert set(np.asarray(batch.count)) >= {0, 1, 2, 3}


@pytest.mark.parametrize("side", [0, 1])
def test_a_flat_top_is_read_in_its_middle(side: int) -> None:
    """A source fits as well anywhere on it, so that the highest pixel tells nothing."""
    at = (np.indices(SHAPE) + 0.5) * CELL[:, None, None]
    away = np.abs(at[side] - 0.078), np.abs(at[1 - side] - 0.08)
    flat = np.exp(-(np.maximum(away[0] - 0.006, 0) ** 2) / 2e-4 - away[1] ** 2 / 3e-4)
    lower = 1 + 1e-3 * np.sign(at[side] - 0.078)  # one end is higher by a thousandth
    found = read(flat * lower, reach=(4, 4))
    np.testing.assert_allclose(found.xy[0, side], 0.078, atol=1e-3)
    np.testing.assert_allclose(found.xy[0, 1 - side], 0.08, atol=1e-4)
