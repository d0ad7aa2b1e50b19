"""The place that `points` finds, as a function of the sensor at fixed voltages."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx

GROUNDS = np.array([1, 3, 5])
ANGLE = 2 * np.pi * np.arange(7) / 7
RING = 0.031 + 0.022 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)


def button(moved: jax.Array) -> tx.Sensor:
    """A disc whose radius, and whose inner electrode's x, are off by `moved`, m."""
    edge = tx.sensor.RoundEdge([0.032, 0.031], 0.031)
    edge = eqx.tree_at(lambda e: e.radius, edge, edge.radius + moved[0])
    xy = jnp.asarray([[0.03, 0.031], *RING]).at[0, 0].add(moved[1])
    return tx.Sensor([0.064, 0.064], xy, outline=edge, divisions=(39, 39))


@pytest.fixture(scope="module")
def place():
    touch = tx.Disc([0.036, 0.025], 0.004, 1.0)
    volts = tx.voltages(button(jnp.zeros(2)), touch, GROUNDS)

    def found(moved: jax.Array) -> jax.Array:
        one = tx.methods.estimate(button(moved), volts, GROUNDS, grid=8)
        return one.contacts.xy[0]

    return found


@pytest.mark.long
@pytest.mark.parametrize("which, close", [("radius", 2e-3), ("electrode", 1e-5)])
def test_slopes_of_a_place_by_the_sensor(place, which, close) -> None:
    """Along a tangent, beside differences of whole estimates.

    By the radius these differences change by 1e-3 with their step: points of the table
    beyond the edge stand for mirrored places, which bend where an edge passes a point.
    """
    at, h = jnp.zeros(2), 1e-6
    along = jnp.array([1.0, 0.0] if which == "radius" else [0.0, 1.0])
    xy, slope = jax.jvp(place, (at,), (along,))
    assert np.hypot(*(xy - np.array([0.036, 0.025]))) < 2e-4
    wanted = (place(at + h * along) - place(at - h * along)) / (2 * h)
    assert abs(wanted).max() > 0.01
    np.testing.assert_allclose(slope, wanted, rtol=0, atol=close * float(abs(wanted).max()))


@pytest.mark.long
def test_slopes_in_reverse(place) -> None:
    at = jnp.zeros(2)
    _, along = jax.jvp(place, (at,), (jnp.array([1.0, 0.0]),))
    by_radius = jax.grad(lambda r: place(jnp.stack([r, 0.0]))[0])(0.0)
    np.testing.assert_allclose(by_radius, along[0], rtol=1e-6)
