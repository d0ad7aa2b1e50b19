"""Derivatives against central differences in float64, on the symmetric 8 × 8 grid.

Steps are ε^(1/3) of each quantity's own scale, where truncation and rounding of a
central difference meet at about 1e-10; a fourth-order difference leaves room to 1e-6.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx

SENSOR_DIVISIONS = (32, 32)


def difference(f, x, direction, step):
    """Fourth-order central difference of f along `direction`."""
    at = lambda n: np.asarray(f(x + n * step * direction))  # noqa: E731
    return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)


def scene() -> tx.Scene:
    # On the sheet's centre and on an electrode: every symmetry there is.
    return tx.Scene(tx.Disc([0.08, 0.08], 0.012, 1.0), tx.Disc([0.05, 0.07], 0.006, 30.0))


def outputs(sensor: tx.Sensor, g, rho):
    """Everything that issue 2 builds, in one vector per output."""
    table = tx.sensor.resistances(sensor)
    j = tx.jacobian(sensor, [0, 27], rho)
    gamma = jnp.zeros((1, 64)).at[0, jnp.array([0, 63])].set(0.25)
    return {
        "ee": table.electrodes,
        "ek": table.elements,
        "kk": table.own,
        "jacobian": j,
        "voltages": tx.voltages(sensor, g),
        "shared": tx.voltages(sensor, g, gamma),
    }


def cases(sensor, g, rng):
    k = sensor.element_count
    replace = dataclasses.replace
    yield "conductance", lambda x: outputs(sensor, x, 1e3), g, g * rng.random(k), 1e-3
    yield (
        "contact resistance",
        lambda x: outputs(sensor, g, x),
        jnp.asarray(1e3),
        1.0,
        1.0,
    )
    rho = jnp.full(k, 1e4)
    yield (
        "sheet",
        lambda x: outputs(replace(sensor, sheet_resistance=x), g, 1e3),
        rho,
        rng.standard_normal(k),
        3.0,
    )
    yield (
        "shunt",
        lambda x: outputs(replace(sensor, electrode_shunt=x), g, 1e3),
        sensor.electrode_shunt,
        1.0,
        1e-3,
    )
    yield (
        "places",
        lambda x: outputs(replace(sensor, electrode_xy=x), g, 1e3),
        sensor.electrode_xy,
        rng.standard_normal((64, 2)),
        3e-6,
    )


def jit_cases(rng):
    sensor = tx.Sensor.grid(divisions=SENSOR_DIVISIONS, electrode_shunt=0.9)
    g = tx.sensor.contact_conductance(sensor, scene())
    return {c[0]: c[1:] for c in cases(sensor, g, rng)}


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    ["sheet", "conductance", "contact resistance", "shunt", "places"],
)
def test_forward_and_reverse_match_differences(name, rng) -> None:
    f, x, direction, step = jit_cases(rng)[name]
    direction = jnp.asarray(direction, x.dtype)
    f = jax.jit(f)
    base, slope = jax.jvp(f, (x,), (direction,))
    cotangent = {
        key: jnp.asarray(rng.standard_normal(v.shape) / (1 + abs(v)))
        for key, v in base.items()
    }
    for key in base:
        want = difference(lambda x, key=key: f(x)[key], x, direction, step)
        scale = np.abs(want).max()
        assert np.isfinite(slope[key]).all()
        if scale > 1e-12 * np.abs(np.asarray(base[key])).max():
            np.testing.assert_allclose(
                slope[key], want, atol=1e-6 * scale, rtol=0, err_msg=key
            )
    (gradient,) = jax.jit(lambda c: jax.vjp(f, x)[1](c))(cotangent)
    assert np.isfinite(gradient).all()
    forward = sum(float(jnp.vdot(cotangent[k], slope[k])) for k in base)
    np.testing.assert_allclose(float(jnp.vdot(gradient, direction)), forward, rtol=1e-8)


def test_gradient_in_the_scene_itself() -> None:
    """Through shape, coverage and sheet: radius, place, angle; none NaN at the centre."""
    sensor = tx.Sensor.grid(divisions=(32, 32))

    def power(p):
        shapes = tx.Scene(
            tx.Disc(p[:2], p[2], 1.0),
            tx.Bar(p[3:5], 0.03, 0.01, p[5], 2.0),
            tx.Ellipse([0.12, 0.12], p[6:8], p[5], 1.0),
        )
        return (tx.voltages(sensor, shapes, [0, 63]) ** 2).sum()

    at = jnp.array([0.08, 0.08, 0.01, 0.05, 0.05, 0.3, 0.01, 0.006])
    gradient = jax.jit(jax.grad(power))(at)
    assert np.isfinite(gradient).all()
    run = jax.jit(power)
    for i in range(len(at)):
        unit = jnp.zeros(len(at)).at[i].set(1.0)
        # The blur's smoothstep is only once differentiable: a small step.
        want = difference(run, at, unit, 2e-8 if i != 5 else 1e-6)
        np.testing.assert_allclose(gradient[i], want, rtol=1e-3, atol=1e-3)


def test_float32_gradients_are_finite_and_close(rng) -> None:
    sensor = {
        d: tx.Sensor.grid(divisions=(24, 24), electrode_diameter=0.007, dtype=d)
        for d in (np.float32, np.float64)
    }
    slopes = {}
    for dtype, s in sensor.items():

        def loss(rho, xy, s=s):
            changed = dataclasses.replace(s, sheet_resistance=rho, electrode_xy=xy)
            return (tx.voltages(changed, scene(), [0, 9]) ** 2).sum()

        rho = jnp.full(s.element_count, 1e4, dtype)
        slopes[dtype] = jax.grad(loss, (0, 1))(rho, s.electrode_xy)
    for single, double in zip(slopes[np.float32], slopes[np.float64]):
        assert single.dtype == np.float32
        scale = float(np.abs(double).max())
        np.testing.assert_allclose(single, double, atol=2e-3 * scale)
