"""Methods as pure functions: of a frame's voltages, and of the sensor."""

import os
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx

GROUNDS = np.array([1, 3, 5])
ANGLE = 2 * np.pi * np.arange(7) / 7
RING = 0.031 + 0.022 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)


KINDS = np.array([[0, 15], [3, 12]])  # grounds of two kinds of scan


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16))


@pytest.fixture(scope="module")
def frames(sensor):
    """Four frames of either kind: two touched, one quiet, one against its drive."""
    discs = [tx.Disc([0.03, 0.05], 0.006, 1.0), tx.Disc([0.051, 0.037], 0.006, 1.0)]
    volts = [np.asarray(tx.voltages(sensor, d, KINDS[k])) for k, d in enumerate(discs)]
    which = np.array([0, 1, 1, 0])
    return np.stack([*volts, 0 * volts[0], -volts[0]]), which


@pytest.mark.parametrize(
    "name",
    ["source"]
    + [
        pytest.param(name, marks=pytest.mark.long)
        for name in ("linear", "points", "auto", "shape")
    ],
)
def test_rows_are_those_of_a_batch(sensor, frames, name) -> None:
    method, (volts, which) = tx.method(sensor, name, 16), frames
    good = np.ones((2, 2, 16), bool)
    good[1, :, 5] = False
    wanted = tx.Batch(method, contacts=2)(volts, KINDS[which], good[which])
    ready = tx.methods.Ready(method, KINDS, good, contacts=2)
    given = jnp.asarray(volts), jnp.asarray(which)
    if name == "auto":  # its larger models are for few frames
        found = jax.jit(lambda *a: jax.lax.map(lambda one: ready(*one), a))(*given)
    else:
        found = jax.jit(jax.vmap(ready))(*given)
    for field, one in found._asdict().items():
        other = getattr(wanted, field)
        if one is None or other is None:
            assert one is None and other is None, field
        elif field in ("flags", "contact_count", "rung"):
            np.testing.assert_array_equal(one, other, field)
        else:
            close = 1e-4 * float(np.nanmax(np.abs(other), initial=1e-9))
            np.testing.assert_allclose(one, other, atol=close, err_msg=field)


@pytest.mark.parametrize("name", ["source", pytest.param("points", marks=pytest.mark.long)])
def test_slopes_by_voltages_beside_differences(sensor, frames, name, rng) -> None:
    """Of place and current, in float64; along a direction of no meaning."""
    method, volts = tx.method(sensor, name, 16), jnp.asarray(frames[0][0])
    if name == "points":
        method = replace(method, exact=True)
    ready = tx.methods.Ready(method, KINDS[0], contacts=1)
    assert volts.dtype == np.float64

    def told(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        row = ready(v)
        return (jnp.append(row.contact_xy[0], 1e3 * row.contact_current[0]),) * 2

    along = jnp.asarray(rng.normal(size=volts.shape)) * abs(volts).max()
    both = jax.jit(jax.jacrev(told, has_aux=True))  # one program to compile
    found, _ = both(volts)
    one, other = (both(volts + side * 1e-6 * along)[1] for side in (1, -1))
    wanted = (one - other) / 2e-6
    slope = jnp.tensordot(found, along, 2)
    np.testing.assert_allclose(slope, wanted, rtol=0, atol=1e-5 * float(abs(wanted).max()))


def test_a_number_that_is_none_fails_its_frame_alone(sensor, frames) -> None:
    ready = tx.methods.Ready(tx.method(sensor, "source", 16), KINDS[0], contacts=1)
    volts = jnp.asarray(frames[0][[0, 0]]).at[1, 0, 3].set(jnp.nan)
    rows = jax.vmap(ready)(volts)
    assert not rows.flags[0] & tx.Flag.SOLVE_FAILED.value
    assert rows.flags[1] & tx.Flag.SOLVE_FAILED.value and rows.contact_count[1] == 0


@pytest.mark.parametrize(
    "given, told",
    [
        (dict(grounds=[0, 16]), "grounds: got"),
        (dict(grounds=[0], good=np.ones((2, 16))), "good: got shape"),
        (dict(grounds=[0], good=np.zeros((1, 16))), "good: got none"),
        (dict(grounds=[0], contacts=0), "contacts: got 0"),
    ],
)
def test_mistakes_are_named(sensor, given, told) -> None:
    with pytest.raises(ValueError, match=told):
        tx.methods.Ready(tx.method(sensor, "source", 16), **given)


def button(radius=0.0, electrode=0.0, across=0.0) -> tx.Sensor:
    """A disc whose radius, inner electrode's x, and middle's x are off by so much, m."""
    edge = tx.sensor.RoundEdge(jnp.array([0.032 + across, 0.031]), 0.031 + radius)
    xy = jnp.asarray([[0.03, 0.031], *RING]).at[0, 0].add(electrode)
    return tx.Sensor([0.064, 0.064], xy, outline=edge, divisions=(39, 39))


@pytest.fixture(scope="module")
def place():
    touch = tx.Disc([0.036, 0.025], 0.004, 1.0)
    volts = tx.voltages(button(), touch, GROUNDS)

    def found(*moved: float | jax.Array) -> jax.Array:
        one = tx.methods.estimate(button(*moved), volts, GROUNDS, grid=8)
        return one.contacts.xy[0]

    return found


@pytest.mark.long
@pytest.mark.parametrize("which, close", [("radius", 2e-3), ("electrode", 1e-5)])
def test_slopes_of_a_place_by_the_sensor(place, which, close) -> None:
    """Along a tangent, beside differences of whole estimates.

    By the radius these differences change by 1e-3 with their step: points of the table
    beyond the edge stand for mirrored places, which bend where an edge passes a point.
    """
    h = 1e-6
    along = np.array([1.0, 0.0] if which == "radius" else [0.0, 1.0])
    xy, slope = jax.jvp(place, (0.0, 0.0), tuple(along.tolist()))
    assert np.hypot(*(xy - np.array([0.036, 0.025]))) < 2e-4
    wanted = (place(*h * along) - place(*-h * along)) / (2 * h)
    assert abs(wanted).max() > 0.01
    np.testing.assert_allclose(slope, wanted, rtol=0, atol=close * float(abs(wanted).max()))


@pytest.mark.long
@pytest.mark.parametrize("name", ["source", "linear"])
def test_slopes_by_lambda(sensor, frames, name) -> None:
    """The brightest pixel's slope, by `jvp` and by `grad`, is that of differences."""
    method, volts = tx.method(sensor, name, 8), jnp.asarray(frames[0][0])
    lam = method.choose_lambda([])

    def brightest(by):
        given = volts, KINDS[0], name
        return tx.methods.estimate(
            sensor, *given, grid=8, lam=lam * jnp.exp(by)
        ).image.max()

    wanted = float(brightest(1e-3) - brightest(-1e-3)) / 2e-3
    _, along = jax.jvp(brightest, (0.0,), (1.0,))
    np.testing.assert_allclose([along, jax.grad(brightest)(0.0)], wanted, rtol=1e-5)


def test_a_lambda_below_zero_is_named(sensor, frames) -> None:
    with pytest.raises(ValueError, match="lam"):
        tx.methods.estimate(sensor, jnp.asarray(frames[0][0]), KINDS[0], lam=-1.0)


SHARDED = """
import jax, numpy as np, tomojax as tx
from jax.sharding import AxisType, PartitionSpec
sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
frames = np.stack([k % 2 * np.asarray(volts) for k in range(16)])
mesh = jax.make_mesh((8,), ("device",), axis_types=(AxisType.Auto,))
apart = dict(in_specs=PartitionSpec("device"), out_specs=PartitionSpec("device"))
for name in ("source", "points"):
    ready = tx.methods.Ready(tx.method(sensor, name, 16), [0, 15], contacts=1)
    find = lambda some: jax.lax.map(ready, some)
    rows = jax.jit(jax.shard_map(find, mesh=mesh, **apart, check_vma=False))(frames)
    assert len(rows.contact_xy.sharding.device_set) == 8
    np.testing.assert_array_equal(rows.contact_count, 8 * [0, 1])
    away = np.hypot(*(np.asarray(rows.contact_xy)[1::2, 0] - [0.03, 0.05]).T)
    assert away.max() < (1e-4 if name == "points" else 2e-3)
"""


@pytest.mark.long
def test_eight_devices_say_what_one_says() -> None:
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"
    command = [sys.executable, "-c", SHARDED]
    subprocess.run(command, check=True, env={**os.environ, "XLA_FLAGS": flags})


@pytest.mark.long
def test_slopes_in_reverse(place) -> None:
    """By the edge's three numbers, of which each costs two tables; electrodes stay."""
    x = lambda by: place(by, 0.0, 0.5 * by)[0]  # noqa: E731
    _, along = jax.jvp(x, (0.0,), (1.0,))
    assert abs(along) > 0.01
    np.testing.assert_allclose(jax.grad(x)(0.0), along, rtol=1e-6)
