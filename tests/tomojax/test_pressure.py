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


def test_kept_in_the_file(tmp_path):
    law = tx.Calibration(pressure=(2e-4, 0.9))
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
    with pytest.raises(ValueError, match="calibration: got none of presses"):
        tx.calibration.pressure(tx.Calibration(), np.ones(3))
    with pytest.raises(ValueError, match="pressure: got"):
        tx.Calibration(pressure=(1.0, -1.0))
