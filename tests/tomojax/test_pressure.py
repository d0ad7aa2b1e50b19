"""Conductance to pressure: a power law of presses."""

import numpy as np
import pytest

import tomojax as tx

AREA = 1e-4


def test_presses_give_their_law_back():
    rng, force = np.random.default_rng(0), np.array([0.2, 0.5, 1.0, 2.0, 5.0])
    g = 3e-4 * (force / AREA) ** 0.8 * AREA * np.exp(rng.normal(0, 0.02, 5))
    found = tx.calibration.calibrate_presses(g, force, AREA, tx.Calibration(noise=1e-3))
    assert found.noise == 1e-3 and found.pressure is not None
    assert abs(found.pressure[1] - 0.8) < 0.03
    radius = np.full(5, np.sqrt(AREA / np.pi))
    np.testing.assert_allclose(tx.calibration.force(found, g, radius), force, rtol=0.06)
    image = g[:3] / AREA
    np.testing.assert_allclose(
        tx.calibration.pressure(found, image), force[:3] / AREA, rtol=0.06
    )


def presses(end, noise, hysteresis=0.0, seed=0):
    """Sixteen presses, loading and unloading: conductances and forces."""
    rng, force = np.random.default_rng(seed), np.geomspace(0.2, 20, 8)
    p = np.concatenate([force, force[::-1]]) / AREA
    way = np.repeat([1, -1], 8)
    g = 1 / (1 / (3e-4 * p**0.8) + 1 / end) * np.exp(rng.normal(0, noise, 16))
    return g * (1 - hysteresis * way) * AREA, p * AREA


@pytest.mark.parametrize("end, numbers", [(np.inf, 2), (3.0, 3)])
def test_presses_choose_their_law(end, numbers):
    """A material that ends at 3 S/m²; 20 N press a power law to 5.2."""
    force_of, chosen = tx.calibration.force, 0
    for seed in range(4):
        found = tx.calibration.calibrate_presses(*presses(end, 0.02, seed=seed), AREA)
        chosen += len(found.pressure) == numbers
        g, force = presses(end, 0.0)
        told = force_of(found, g, np.full(16, np.sqrt(AREA / np.pi)))
        off = np.sqrt(np.mean(np.log(told / force) ** 2))
        stated = found.deviation["force"]
        assert off < 2 * stated and 0.015 < stated < (0.05 if end > 9 else 0.12)
    assert chosen >= 3


def test_hysteresis_is_in_the_error():
    stated = [
        tx.calibration.calibrate_presses(*presses(np.inf, 0.01, part), AREA).deviation
        for part in (0.0, 0.2)
    ]
    assert 0.2 < stated[1]["force"] < 0.35 and stated[0]["force"] < 0.03


def played(force: np.ndarray, width: float) -> np.ndarray:
    """A material of plays of many widths, which is not the law's own: g along a course."""
    p, half = np.log(force / AREA), np.linspace(0, width, 40)
    at, shift = p[0] - half, []
    for x in p:
        at = np.clip(at, x - half, x + half)
        shift.append(at.mean() + width / 2)
    return 3e-4 * np.exp(0.8 * np.array(shift)) * AREA


def looped(width: float, seed: int = 0) -> tuple[tx.Calibration, np.ndarray]:
    """The law of presses at eight forces both ways, told so; and the presses' forces."""
    rng, force = np.random.default_rng(seed), np.geomspace(0.2, 20, 8)
    up = np.geomspace(0.05, 20, 400)
    g = played(np.concatenate([up, up[::-1]]), width)
    ways = np.interp(force, up, g[:400]), np.interp(force, up, g[400:][::-1])
    g, both = np.concatenate(ways) * np.exp(rng.normal(0, 0.02, 16)), np.tile(force, 2)
    back = np.repeat([False, True], 8)
    return tx.calibration.calibrate_presses(g, both, AREA, unloading=back), both


@pytest.mark.parametrize("width", [0.15, 0.3])
def test_a_loop_is_followed_over_time(width):
    """A finger that presses and lets go; the loop's middle is twice as far off."""
    known, _ = looped(width)
    t = np.linspace(0, 1, 1000)
    course = 0.3 + 6 * np.abs(np.sin(5 * np.pi * t)) + np.sin(22 * np.pi * t) ** 2
    g = played(course, width) * np.exp(np.random.default_rng(1).normal(0, 0.01, 1000))
    radius = np.full(1000, np.sqrt(AREA / np.pi))
    middle, followed = (
        tx.calibration.force(known, g, radius, over_time=way) for way in (False, True)
    )
    off = [np.sqrt(np.mean(np.log(told / course) ** 2)) for told in (middle, followed)]
    assert 1.05 < known.hysteresis < 1.5 and off[1] < 0.65 * off[0]


def test_no_loop_is_made_up():
    known, _ = looped(0.0)
    assert known.hysteresis < 1.02
    back = np.repeat([False, True], 8)
    g, force = presses(np.inf, 0.02)
    found = tx.calibration.calibrate_presses(g, force, AREA, unloading=back)
    assert found.hysteresis < 1.03
    assert found.deviation["force"] < 0.04


def test_no_force_is_told_beyond_the_end():
    law = tx.Calibration(pressure=(3e-4, 0.8, 3.0))
    told = tx.calibration.pressure(law, np.array([0.0, 1.0, 2.99, 3.0, 9.0]))
    assert np.isnan(told[3:]).all() and (np.diff(told[:3]) > 0).all()
    wanted = (1 / (1 / 1.0 - 1 / 3.0) / 3e-4) ** (1 / 0.8)
    np.testing.assert_allclose(told[1], wanted)


@pytest.mark.parametrize("numbers", [(2e-4, 0.9), (2e-4, 0.9, 3.0)])
def test_kept_in_the_file(tmp_path, numbers):
    law = tx.Calibration(pressure=numbers)
    law.save(tmp_path / "c.json")
    assert tx.Calibration.load(tmp_path / "c.json") == law


def test_bad_presses():
    for g, force, match in (
        ([1e-5], [1.0], "conductance: got shape"),
        ([1e-5, 2e-5], [1.0], "force: got shape"),
        ([1e-5, 2e-5], [1.0, -1.0], "force: got"),
        ([1e-5, 2e-5], [1.0, 1.0], "force: got the same pressure"),
        ([2e-5, 1e-5], [1.0, 2.0], "force: got an exponent"),
    ):
        with pytest.raises(ValueError, match=match):
            tx.calibration.calibrate_presses(np.array(g), np.array(force), AREA)
    for back in ([True], [0.5, 1.0]):
        with pytest.raises(
            ValueError, match=r"unloading: got .*, expected booleans \(2,\)"
        ):
            tx.calibration.calibrate_presses(
                np.array([1e-5, 2e-5]), np.array([1.0, 2.0]), AREA, unloading=np.array(back)
            )
    with pytest.raises(ValueError, match="hysteresis: got"):
        tx.Calibration(hysteresis=0.9)
    with pytest.raises(ValueError, match="calibration: got none of presses"):
        tx.calibration.pressure(tx.Calibration(), np.ones(3))
    with pytest.raises(ValueError, match="pressure: got"):
        tx.Calibration(pressure=(1.0, -1.0))
