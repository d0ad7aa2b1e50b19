"""The table of resistances against scikit-fem, the other route, and finer meshes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import references

import tomojax as tx
from tomojax.kernels.rectangle import Series
from tomojax.kernels.sheet import centroids, rectangle_green
from tomojax.sensor import sheet_on_mesh


def relative(got, want) -> float:
    return float(np.abs(np.asarray(got) - want).max() / np.abs(want).max())


@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-12), (np.float32, 1e-4)])
@pytest.mark.parametrize("uneven, shunt", [(False, None), (True, None), (True, 1.0)])
@pytest.mark.parametrize(
    "divisions",
    [(24, 36), *(pytest.param(n, marks=pytest.mark.long) for n in ((40, 40), (17, 16)))],
)
def test_fem_table_is_skfem(divisions, uneven, shunt, dtype, tolerance, rng) -> None:
    k = 2 * divisions[0] * divisions[1]
    sheet = 1e4 * np.exp(0.5 * rng.standard_normal(k)) if uneven else 1e4
    sensor = tx.Sensor.grid(
        6,
        6,
        electrode_diameter=0.008,
        sheet_resistance=sheet,
        electrode_shunt=shunt,
        divisions=divisions,
        dtype=dtype,
    )
    table = tx.sensor.resistances(sensor)
    assert all(part.dtype == dtype for part in table)
    exact = jax.tree.map(lambda leaf: leaf.astype(np.float64), sensor)
    for got, want in zip(table, references.skfem_table(exact, sheet_on_mesh(exact))):
        assert relative(got, want) <= tolerance


def test_series_is_the_textbook_double_series() -> None:
    """Σ_mn cos cos cos cos / (k_m² + k_n²) to 1500 × 1500 terms, far apart points."""
    a, b = 0.13, 0.09
    one, other = np.array([0.02, 0.03]), np.array([0.1, 0.055])
    m, n = np.arange(1500)[:, None], np.arange(1500)[None, :]
    weight = np.where(m > 0, 2, 1) * np.where(n > 0, 2, 1)
    square = (m * np.pi / a) ** 2 + (n * np.pi / b) ** 2
    square[0, 0] = np.inf
    wave = lambda x: np.cos(m * np.pi * x[0] / a) * np.cos(n * np.pi * x[1] / b)  # noqa: E731
    want = (weight * wave(one) * wave(other) / square).sum() / (a * b)
    size = jnp.array([a, b])
    got = rectangle_green(jnp.array(one), jnp.array(other), jnp.array(0.0), size)
    # The truncated double series itself is good to about 1/1500².
    assert abs(float(got) - want) < 1e-6
    turned = rectangle_green(
        jnp.array(one[::-1]), jnp.array(other[::-1]), jnp.array(0.0), size[::-1]
    )
    np.testing.assert_allclose(turned, got, rtol=1e-13)
    # NumPy alone, with fewer terms: as `tomojax check` has it.
    series = Series(tuple(one[::-1]), tuple(other[::-1]), (b, a), np, terms=3)
    np.testing.assert_allclose(series.potential(1e-6), got, rtol=1e-8)


def test_long_strip_has_the_resistance_of_a_wire() -> None:
    """Far from its ends a strip of width w is ρ·length/w, whatever the feeds do."""
    rho, width = 1e4, 0.02
    xy = np.array([[0.05, 0.01], [0.35, 0.01], [0.15, 0.01], [0.25, 0.01]])
    strip = tx.Sensor([0.4, width], xy, 0.004, rho, divisions=(200, 10))
    for route in ("fem", "series"):
        r = np.asarray(tx.sensor.resistances(strip, route).electrodes)
        drop = (r[0] - r[1])[2] - (r[0] - r[1])[3]  # 1 A from 0 to 1, read between 2 and 3
        np.testing.assert_allclose(drop, rho * 0.1 / width, rtol=1e-6)


@pytest.mark.long
def test_mesh_converges_in_second_order_to_the_series() -> None:
    """Resistances between electrodes and far elements, smooth in the mesh: slope ≥ 1.8."""
    divisions = np.array([24, 32, 48, 64, 96])
    errors = []
    for n in divisions.tolist():
        # A feed that every mesh here resolves: the same functional throughout.
        sensor = tx.Sensor.grid(
            4, 4, 0.04, 0.02, electrode_diameter=0.016, divisions=(n, n)
        )
        table, exact = (
            tx.sensor.resistances(sensor),
            tx.sensor.resistances(sensor, "series"),
        )
        ee = np.asarray(table.electrodes - exact.electrodes)
        errors.append(np.sqrt((ee[~np.eye(16, dtype=bool)] ** 2).mean()))
    order = -np.polyfit(np.log(divisions), np.log(errors), 1)[0]
    assert order >= 1.8, (order, errors)


@pytest.mark.long
@pytest.mark.parametrize("shift", [0.0, 0.7e-3])
def test_own_resistance_hardly_depends_on_the_mesh(shift) -> None:
    """A 5 mm disc at the default mesh against one four times finer, and the series."""
    base = tx.Sensor.grid()
    xy = base.electrode_xy[18:46] + shift
    own = {}
    for n in (64, 256):
        sensor = tx.Sensor(base.size, xy, divisions=(n, n))
        table = tx.sensor.resistances(sensor)
        own[n] = np.diag(table.electrodes)
        exact = np.diag(tx.sensor.resistances(sensor, "series").electrodes)
        np.testing.assert_allclose(own[n], exact, rtol=1e-2)
    np.testing.assert_allclose(own[64], own[256], rtol=1e-2)


@pytest.mark.parametrize("shunt", [None, pytest.param(1.0, marks=pytest.mark.long)])
def test_routes_agree_away_from_electrodes(paper_sensor, shunt) -> None:
    sensor = dataclasses.replace(paper_sensor, electrode_shunt=shunt)
    fem, series = (tx.sensor.resistances(sensor, r) for r in ("fem", "series"))
    elements = np.asarray(centroids(sensor.divisions, sensor.size))
    places = np.asarray(sensor.electrode_xy)
    apart = np.linalg.norm(elements[:, None] - places[None], axis=-1).min(1)
    difference = np.abs(np.asarray(fem.elements - series.elements))[:, apart > 0.006]
    # At 6 mm a place wrong by 1 mm would make 265 Ω.
    assert difference.max() < (40 if shunt is None else 80)
    assert np.median(difference) < 3
    # The element's own term differs by what an element is, the same all over the inside.
    inside = (np.minimum(elements, 0.16 - elements).min(1) > 0.01) & (apart > 0.006)
    own = np.asarray(fem.own - series.own)[inside]
    assert np.std(own) < 0.02 * np.abs(own).mean()


def test_floating_discs_lower_the_effective_resistance() -> None:
    """A sheet that a fraction φ of is metal conducts 1 + 2φ + … better (Maxwell)."""
    xy = (np.stack(np.meshgrid(np.arange(24), np.arange(4), indexing="ij"), -1)).reshape(
        -1, 2
    )
    strip = tx.Sensor([0.48, 0.08], xy * 0.02 + 0.01, 0.005, divisions=(192, 32))
    drops = []
    for shunt in (None, 1.0):
        r = tx.sensor.resistances(
            dataclasses.replace(strip, electrode_shunt=shunt)
        ).electrodes
        potential = (r[:4] - r[-4:]).mean(0).reshape(24, 4).mean(1)
        drops.append(float(potential[6] - potential[17]))
    fraction = np.pi * 0.0025**2 / 0.02**2
    # Rayleigh: (1 + φ)/(1 − φ) but for terms in φ⁴.
    np.testing.assert_allclose(
        drops[0] / drops[1], (1 + fraction) / (1 - fraction), rtol=5e-3
    )


@pytest.mark.long
def test_float32_table_at_a_fine_mesh() -> None:
    """Errors of float32 grow with the mesh; at 160 × 160 they stay below 1e-4."""
    fine = [
        tx.sensor.resistances(tx.Sensor.grid(divisions=(160, 160), dtype=d))
        for d in (np.float32, np.float64)
    ]
    for single, double in zip(*fine):
        assert relative(single, np.asarray(double)) <= 1e-4


def test_table_under_vmap() -> None:
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))

    def table(rho):
        changed = tx.Sensor(
            sensor.size, sensor.electrode_xy, sheet_resistance=rho, divisions=(16, 16)
        )
        return tx.sensor.resistances(changed)

    many = jax.vmap(table)(jnp.array([5e3, 1e4]))
    for part in many:
        np.testing.assert_allclose(2 * part[0], part[1], rtol=1e-10, atol=1e-9)
