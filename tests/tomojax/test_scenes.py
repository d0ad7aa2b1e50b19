"""Shapes, moving scenes and the converter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.kernels.sheet import centroids

SHAPES = {
    "disc": (tx.Disc([0.08, 0.07], 0.011, 2.0), np.pi * 0.011**2, (0.08, 0.07)),
    "ellipse": (
        tx.Ellipse([0.07, 0.08], [0.02, 0.008], 0.5, 2.0),
        np.pi * 0.02 * 0.008,
        (0.07, 0.08),
    ),
    "bar": (tx.Bar([0.08, 0.09], 0.05, 0.012, -0.4, 2.0), 0.05 * 0.012, (0.08, 0.09)),
    "ring": (
        tx.Ring([0.08, 0.08], 0.02, 0.028, 2.0),
        np.pi * (0.028**2 - 0.02**2),
        (0.08, 0.08),
    ),
    "polygon": (
        tx.sensor.Polygon([[0.05, 0.05], [0.1, 0.05], [0.1, 0.1], [0.075, 0.07]], 2.0),
        0.001125,
        None,
    ),
    "mask": (
        tx.sensor.Mask(np.pad(np.full((2, 3), 2.0), ((4, 10), (6, 7)))),
        6e-4,
        (0.05, 0.075),
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_total_conductance_and_place(name) -> None:
    shape, area, center = SHAPES[name]
    sensor = tx.Sensor.grid(divisions=(64, 64))
    g = np.asarray(tx.sensor.contact_conductance(sensor, shape))
    np.testing.assert_allclose(g.sum(), 2.0 * area, rtol=0.02)
    if center is not None:
        xy = np.asarray(centroids(sensor.divisions, sensor.size))
        np.testing.assert_allclose(g @ xy / g.sum(), center, atol=2e-4)


@pytest.mark.parametrize(
    "make",
    [
        lambda total: tx.Disc.of_total([0.08, 0.07], 0.004, total),
        lambda total: tx.Ellipse.of_total([0.07, 0.08], [0.02, 0.008], 0.5, total),
        lambda total: tx.Bar.of_total([0.08, 0.09], 0.05, 0.012, -0.4, total),
        lambda total: tx.Ring.of_total([0.08, 0.08], 0.02, 0.028, total),
    ],
    ids=["disc", "ellipse", "bar", "ring"],
)
def test_shapes_of_a_total_conductance(make) -> None:
    sensor = tx.Sensor.grid(divisions=(64, 64))
    g = tx.sensor.contact_conductance(sensor, make(3e-4))
    np.testing.assert_allclose(g.sum(), 3e-4, rtol=0.01)
    with pytest.raises(ValueError, match="siemens: got -1"):
        make(-1.0)
    slope = jax.grad(lambda total: make(total).conductance)(3e-4)
    np.testing.assert_allclose(slope * 3e-4, make(3e-4).conductance, rtol=1e-12)


OFF = "lies off the sheet of 0.16 m × 0.16 m at"


@pytest.mark.parametrize(
    "shape, told",
    [
        (tx.Disc([70, 50], 5, 1.0), rf"center: the disc {OFF} \[70, 50\] m; lengths are"),
        (tx.Ellipse([70, 50], [5, 2], 0.3, 1.0), f"center: the ellipse {OFF}"),
        (tx.Bar([70, 50], 30, 8, 0.3, 1.0), f"center: the bar {OFF}"),
        (tx.Ring([0.08, -0.03], 0.01, 0.02, 1.0), f"center: the ring {OFF}"),
        (
            tx.sensor.Polygon([[60, 50], [80, 50], [70, 70]], 1.0),
            f"vertices: the polygon {OFF}",
        ),
        (
            tx.Scene(
                tx.Disc([0.07, 0.05], 0.005, 1.0), tx.Scene(tx.Disc([70, 50], 5, 1.0))
            ),
            f"center: the disc {OFF}",
        ),
    ],
)
def test_shapes_off_the_sheet(shape, told) -> None:
    sensor = tx.Sensor.grid(divisions=(32, 32))
    with pytest.raises(ValueError, match=told):
        tx.voltages(sensor, shape, [0])
    with pytest.raises(ValueError, match=told):
        tx.sensor.contact_conductance(sensor, shape)


def test_off_the_sheet_is_no_error_where_values_are_not_known() -> None:
    """A search over places may go there; what reaches onto the sheet always may."""
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))

    def total(x):
        disc = tx.Disc(jnp.stack([x, x * 0 + 0.04]), 0.01, 1.0)
        return tx.sensor.contact_conductance(sensor, disc).sum()

    totals = jax.jit(jax.vmap(total))(jnp.array([0.04, -0.005, -0.03]))
    assert totals[0] > totals[1] > totals[2] == 0
    assert total(-0.005) > 0


def test_polygon_either_way_round_and_bar_as_polygon() -> None:
    sensor = tx.Sensor.grid()
    corners = np.array([[0.05, 0.06], [0.09, 0.06], [0.09, 0.07], [0.05, 0.07]])
    bar = tx.sensor.contact_conductance(sensor, tx.Bar([0.07, 0.065], 0.04, 0.01, 0.0, 1.0))
    for vertices in (corners, corners[::-1]):
        g = tx.sensor.contact_conductance(sensor, tx.sensor.Polygon(vertices, 1.0))
        np.testing.assert_allclose(g, bar, atol=1e-18)


def test_scene_adds_conductances_and_falls_off_the_edge() -> None:
    sensor = tx.Sensor.grid()
    one, other = tx.Disc([0.05, 0.05], 0.01, 1.0), tx.Disc([0.055, 0.05], 0.01, 3.0)
    sum_ = sum(tx.sensor.contact_conductance(sensor, s) for s in (one, other))
    both = tx.sensor.contact_conductance(sensor, tx.Scene(one, tx.Scene(other)))
    np.testing.assert_allclose(both, sum_, rtol=1e-12)
    half = tx.sensor.contact_conductance(sensor, tx.Disc([0.0, 0.08], 0.02, 1.0))
    np.testing.assert_allclose(half.sum(), np.pi * 0.02**2 / 2, rtol=0.03)


def test_moving_scene_is_the_shape_at_each_time() -> None:
    sensor = tx.Sensor.grid(4, 4, divisions=(20, 20))
    disc = tx.Disc([0.03, 0.04], 0.008, 1.0)
    moving = tx.sensor.Moving(disc, [0.0, 1.0], [[0, 0], [0.02, -0.01]], [1.0, 3.0])
    times, grounds = [0.0, 0.5, 1.0, 2.0], [0, 15, 3, 3]
    got = tx.voltages(sensor, moving, grounds, times=times)
    for row, ground, x, y, c in zip(
        got, grounds, [0.03, 0.04, 0.05, 0.05], [0.04, 0.035, 0.03, 0.03], [1, 2, 3, 3]
    ):
        still = tx.Disc([x, y], 0.008, float(c))
        np.testing.assert_allclose(row, tx.voltages(sensor, still, [ground])[0], rtol=1e-9)
    same = tx.voltages(sensor, lambda t: moving(t), grounds, times=times)
    np.testing.assert_allclose(same, got, rtol=1e-12)
    gamma = np.zeros((4, 16))
    gamma[np.arange(4), grounds] = 0.25
    np.testing.assert_allclose(
        tx.voltages(sensor, moving, gamma, times=times), got, atol=1e-10
    )


def test_converter_noise_steps_and_rails() -> None:
    volts = jnp.linspace(-6, 6, 4001)
    step = 10 / 2**16
    read = tx.Converter(noise=0.0)(volts)
    inside = np.abs(np.asarray(volts)) < 4.99
    assert np.abs(np.asarray(read - volts))[inside].max() <= step / 2 * 1.001
    np.testing.assert_allclose(np.asarray(read) / step, np.round(read / step), atol=1e-6)
    assert float(read.max()) == 5.0 - step and float(read.min()) == -5.0
    noisy = tx.Converter(noise=1e-3, bits=None)(0 * volts, jax.random.key(1))
    np.testing.assert_allclose(noisy.std(), 1e-3, rtol=0.05)
    slope = jax.grad(lambda v: tx.Converter(noise=0.0)(v).sum())(volts)
    np.testing.assert_array_equal(slope, 1.0)


def test_same_numbers_alone_jitted_and_batched() -> None:
    sensor = tx.Sensor.grid(4, 4, divisions=(20, 20))

    def read(x, conductance):
        return tx.voltages(sensor, tx.Disc([x, 0.04], 0.008, conductance), [0, 5])

    x, c = jnp.array([0.02, 0.03, 0.05]), jnp.array([1e-3, 1.0, 1e3])
    alone = jnp.stack([read(*pair) for pair in zip(x, c)])
    np.testing.assert_allclose(jax.vmap(read)(x, c), alone, atol=1e-10)
    np.testing.assert_allclose(jax.jit(jax.vmap(read))(x, c), alone, atol=1e-10)


def test_float32_in_float32_out() -> None:
    sensor = tx.Sensor.grid(dtype=jnp.float32)
    scene = tx.Scene(
        tx.Disc([0.06, 0.07], 0.008, 1.0), tx.Bar([0.1, 0.1], 0.04, 0.01, 1.0, 5.0)
    )
    single = tx.voltages(sensor, scene)
    double = tx.voltages(tx.Sensor.grid(), scene)
    assert single.dtype == jnp.float32 and double.dtype == jnp.float64
    np.testing.assert_allclose(single, double, atol=1e-4 * 4.5)
    assert tx.jacobian(sensor, [0]).dtype == jnp.float32


def test_no_retracing_for_new_values(small_sensor) -> None:
    from tomojax.sensor import exact_voltages

    traces = 0

    def counted(g, grounds):
        nonlocal traces
        traces += 1
        return exact_voltages(small_sensor, g, grounds)

    run = jax.jit(counted)
    for seed in range(3):
        run(jax.random.uniform(jax.random.key(seed), 320), jnp.array([seed, 7 - seed]))
    assert traces == 1


def test_noise_has_the_converters_codes() -> None:
    """10⁻⁴ of the drive, or the spread of what is rounded off where that is more."""
    fine = tx.Sensor.grid(4, 4, drive_voltage=2.0, divisions=(16, 16))
    assert tx.sensor.nominal_noise(fine) == pytest.approx(2e-4)
    coarse = tx.Sensor.grid(4, 4, drive_voltage=2.0, divisions=(16, 16), resolution=0.01)
    read = np.round(np.random.default_rng(0).uniform(0, 1, 100_000) / 0.01) * 0.01
    off = np.std(read - np.random.default_rng(0).uniform(0, 1, 100_000))
    assert tx.sensor.nominal_noise(coarse) == pytest.approx(off, rel=0.01)
    rig = tx.recordings.Rig.of(coarse)
    assert rig.resolution == pytest.approx(0.01)
    assert float(rig.sensor().resolution) == pytest.approx(0.01)
