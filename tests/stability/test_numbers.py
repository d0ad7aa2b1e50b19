"""Gradients of the whole pipeline, solvers in float32, faults that are no sweep."""

import jax
import numpy as np
import pytest

import tomojax as tx
from bench.stability import (
    gradient_rows,
    pipeline,
    random_points,
    RANGES,
    resistance_rows,
    small,
    solver_rows,
    start_rows,
    symmetric_points,
)
from tomojax.kernels.sheet import centroids
from tomojax.methods import Frame


@pytest.mark.long
def test_gradients_are_finite_and_right():
    for row in gradient_rows(100, 100, seed=5):
        assert row["finite"] == row["count"] == 100
        assert set(row["largest_difference"]) == set(RANGES)
        assert max(row["largest_difference"].values()) < 1e-5, row


def test_symmetric_points_are():
    points = symmetric_points(100)
    on_axis = (points["x"] == 0.04) | (points["y"] == 0.04)
    on_diagonal = points["x"] == points["y"]
    on_electrode = np.isin(points["x"], [0.01, 0.03, 0.05, 0.07])
    assert (on_axis | on_diagonal | on_electrode).all()
    assert (np.ptp(points["weights"], 1) == 0).all() and not points["shift"].any()
    assert {k: v.shape for k, v in points.items()} == {
        k: v.shape for k, v in random_points(100).items()
    }


def test_the_pipeline_is_a_measure_of_an_image():
    """Of a blurred one it is larger."""
    sensor = small(np.float64)
    middles = centroids(sensor.divisions, sensor.size)
    point = {k: jax.numpy.asarray(v[0]) for k, v in random_points(1).items()}
    sharp, blurred = (
        float(pipeline(sensor, middles, point | {"log_lam": jax.numpy.log(lam)}))
        for lam in (1e-6, 10.0)
    )
    assert 0 < sharp < blurred


def test_solvers_in_float32():
    """Of "double", which "auto" is, 2e-3 down to 1e-12·σ₁², all of it J's own rounding to
    float32. Cholesky fails as a NaN."""
    rows = solver_rows()
    mine = [r for r in rows if r["solver"] == "double"]
    assert all(r["error"] is not None and r["error"] < 3e-3 for r in mine)
    assert max(r["error"] for r in mine if r["relative_lam"] > 1e-9) < 1e-4
    plain = {r["relative_lam"]: r["error"] for r in rows if r["solver"] == "cholesky"}
    assert plain[min(plain)] is None and plain[max(plain)] < 1e-5


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_whatever_contact_resistance_is_told(kind):
    """J(0) is of metal; far too much of it does no harm. Infinity is an error."""
    rows = resistance_rows(kind, seed=7)
    assert rows[-1]["resistance"] is None and "contact_resistance" in rows[-1]["raised"]
    assert not any(row["silent"] for row in rows)
    away = {row["resistance"]: row["place_median_mm"] for row in rows[:-1]}
    assert all(away[rho] < 5 for rho in away if rho >= 1) and away[0.0] > 8


@pytest.mark.long
def test_optimisers_from_bad_starts():
    """Both ended elsewhere, or as NaN, from the first and the last of these once."""
    rows = start_rows((1e-14, 1e-5, 1e7), seed=3)
    excess = {(row["optimiser"], row["start"]): row["excess"] for row in rows}
    assert len(excess) == 6 and None not in excess.values()
    assert all(v < 1e-3 for (name, _), v in excess.items() if name == "tune")
    assert all(v < 0.1 for v in excess.values())


@pytest.fixture(scope="module")
def batch():
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(64, 64))
    model = tx.method(sensor, "source", 16)
    return tx.Batch(model, model.choose_lambda([]))


def frame(slots):
    rng = np.random.default_rng(0)
    return rng.normal(0.3, 0.1, (1, slots, 64)).astype(np.float32)


def test_no_slots_are_an_error(batch):
    with pytest.raises(ValueError, match="a slot at least"):
        batch(frame(0), np.zeros((1, 0), int))


@pytest.mark.long
def test_a_ground_that_is_repeated_counts_as_its_slots_do(batch):
    v = frame(1)
    once = batch(v, np.array([[5]]))
    twice = batch(np.concatenate([v, v], 1), np.array([[5, 5]]))
    np.testing.assert_allclose(twice.contact_xy, once.contact_xy, atol=1e-6)
    np.testing.assert_allclose(twice.image, once.image, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_refused_where_it_is_used(batch, value):
    v = frame(2)
    v[0, 1, 3] = value
    with pytest.raises(ValueError, match="voltages"):
        batch(v, np.array([[0, 63]]), np.ones(v.shape, bool))
    # Left out by itself where nobody says so.
    assert np.isfinite(batch(v, np.array([[0, 63]])).residual).all()


def test_frames_without_a_channel_leave_the_usual_lambda(batch):
    model = batch.method
    nothing = Frame(np.zeros((2, 64)), np.array([0, 63]), np.zeros((2, 64), bool))
    assert model.choose_lambda([nothing]) == model.choose_lambda([])


def test_few_channels_place_a_contact_badly(batch):
    v = np.repeat(frame(2), 2, 0)
    v[0, :, 17:] = np.nan
    v[1, :, 16:] = np.nan
    flags = batch(v, np.array([[0, 63]] * 2)).flags
    assert (flags & tx.Flag.PLACE_UNCERTAIN > 0).tolist() == [False, True]
