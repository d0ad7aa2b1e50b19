"""`tomojax frontier`: peers are what they are named after, and get what ours get."""

import json

import numpy as np
import pytest
import references
import scipy.sparse.linalg

import tomojax as tx
from bench.frontier import (
    best_lambda,
    Job,
    jobs as study_jobs,
    KINDS,
    make_trials,
    paper_jacobian,
    peer_rows,
    peer_table,
    peers_of,
    pixel_places,
    read_half,
    read_peak,
)
from tomojax.kernels.sheet import nodes as mesh_nodes


@pytest.fixture(scope="module")
def small():
    """Electrodes on nodes of the peers' mesh for 16 pixels along a side."""
    return tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float64)


def test_peers_have_the_paper_s_jacobian(small):
    """Voltages with 1 V on a pixel and one electrode grounded, solved at once."""
    jac, loops = paper_jacobian(peer_table(small, 16))
    shape, ground, pixel, m = (64, 64), 9, 100, 16
    nodes = np.asarray(mesh_nodes(shape, small.size))
    places = np.concatenate(
        [np.asarray(small.electrode_xy), pixel_places(16, np.asarray(small.size))]
    )
    at = ((nodes[:, None] - places) ** 2).sum(-1).argmin(0)
    np.testing.assert_allclose(nodes[at], places, atol=1e-12)
    sheet = np.full(2 * 64**2, 1e-4)
    stiffness = references.skfem_stiffness(sheet, shape, small.size)
    # A node of spacing 1.25 mm as a disc of 2.5 mm instead of 0.25: less in series.
    series = 4.0 + 1e4 / (2 * np.pi) * np.log(0.2 * 1.25 / 2.5)
    u = np.zeros(len(nodes))
    u[at[m + pixel]] = 1.0
    free = np.flatnonzero(u == 0)
    system = stiffness.tolil()
    system[at[ground], at[ground]] += 1 / series
    system = system.tocsc()
    right = -(system @ u)[free]
    u[free] = scipy.sparse.linalg.spsolve(system[free][:, free], right)
    current = u[at[ground]] / series
    assert loops[ground, pixel] == pytest.approx(1 / current, rel=1e-6)
    others = np.delete(np.arange(m), ground)
    np.testing.assert_allclose(jac[ground, others, pixel], u[at[others]], atol=1e-7)
    # What the channel itself reads is behind the disc, before the ground path.
    assert jac[ground, ground, pixel] == pytest.approx(4.0 * current, rel=1e-6)


def test_operators_are_what_they_are_named_after(small):
    """Each peer's image beside its formula in full, of random voltages of two slots."""
    rng, grounds, lam = np.random.default_rng(0), np.array([0, 15]), 1e-3
    volts = rng.normal(size=(3, 32))
    found = {(p[1].name, p[1].products): p[1] for p in peers_of(small, 8)}
    assert {p.stands for p in found.values()} == {"mean"}
    table = peer_table(small, 8, "mean")
    jac = paper_jacobian(table)[0][grounds].reshape(32, 64)

    def inverse(rows, damping):
        largest = np.linalg.norm(rows, 2) ** 2
        normal = rows.T @ rows + lam * largest * damping
        return np.linalg.solve(normal, rows.T)

    expected = {("scikit-fem + NumPy", 1): volts @ inverse(jac, np.eye(64)).T}
    weights = np.sqrt((jac**2).sum(0))
    kotre = inverse(jac, np.diag(weights / weights.mean()))
    expected["pyEIT", 1] = volts @ kotre.T
    maps = [table.transfer(int(g)) for g in grounds]
    backs = [inverse(rows, np.eye(64)) for rows in maps]
    seen = np.array([np.diagonal(b @ rows) for b, rows in zip(backs, maps)])
    slots = volts.reshape(3, 2, 16)
    each = [slots[:, k] @ backs[k].T for k in range(2)]
    one = np.mean([image / np.sqrt(d) for image, d in zip(each, seen)], 0)
    expected["NumPy sLORETA", 1] = one
    expected["NumPy sLORETA", 2] = np.mean(each, 0) / np.sqrt(seen.mean(0))
    assert found.keys() == expected.keys()
    for key, images in expected.items():
        got = found[key].prepare(grounds, lam, "float64")(volts)
        np.testing.assert_allclose(got, images, atol=1e-7 * np.abs(images).max())
        single = found[key].prepare(grounds, lam, "float32")(volts.astype("f4"))
        assert single.dtype == np.float32
        np.testing.assert_allclose(single, images, atol=1e-4 * np.abs(images).max())


def test_places_are_read_between_pixels():
    size, pixels = np.array([0.16, 0.08]), 16
    centres = pixel_places(pixels, size)
    places = np.array([[0.083, 0.041], [0.02, 0.061], [0.0, 0.08]])
    away = ((centres - places[:, None]) / size) ** 2
    bowl = (1 - away.sum(-1)).astype("f4")
    np.testing.assert_allclose(read_peak(bowl, pixels, size), places, atol=2e-5)
    hill = np.exp(-away.sum(-1)[:2] / 0.01).astype("f4")
    np.testing.assert_allclose(read_half(hill, pixels, size), places[:2], atol=1e-3)
    # Nothing to be seen is a place on the sheet, not a number that is none.
    flat = np.zeros((2, pixels**2), "f4")
    assert np.isfinite([read(flat, pixels, size) for read in (read_peak, read_half)]).all()


@pytest.mark.parametrize(
    "best, at_end", [(-3.0, False), (-11.5, False), (4.0, False), (40.0, True)]
)
def test_the_range_of_lambda_has_the_best_inside(best, at_end):
    lam, end = best_lambda(lambda x: 1 + abs(np.log10(x) - best))
    assert end == at_end and (at_end or lam == pytest.approx(10.0**best))
    # Where it no longer matters, nothing is won by going on.
    lam, end = best_lambda(lambda x: max(1.0, 2 + np.log10(x)))
    assert not end and lam <= 0.1


@pytest.mark.long
def test_rows_of_peers(small, monkeypatch):
    monkeypatch.setattr("bench.frontier._measure._SECONDS", 0.0)
    trials = make_trials(small, 2, 3)
    job = Job("peers", ("corners", "around"), batches=(1, 4), pixels=8)
    rows = list(peer_rows(job, small, trials))
    json.dumps(rows)
    told = {(r["method"], r["products"], r["pattern"]) for r in rows}
    assert len(told) == 4 + 3 and ("pyEIT", 1, "around") not in told
    # Outputs, batches, kinds; each says what it is of.
    assert len(rows) == len(told) * 2 * 2 * len(KINDS) and all(r["peer"] for r in rows)
    assert {(r["output"], r["batch"], r["dtype"]) for r in rows} == {
        (output, batch, "float32") for output in ("contacts", "image") for batch in (1, 4)
    }
    ones = [r for r in rows if r["scene"] == "one" and r["method"] == "NumPy sLORETA"]
    assert all(r["with_ghosts_median_mm"] < 10 and not r["lam_at_end"] for r in ones)
    single = [r for r in rows if r["output"] == "contacts"]
    assert all(r["ghosts"] == 0 and "image_error" not in r for r in single)
    assert all(r["count_right"] == 0 for r in single if r["scene"] == "three")


def test_peers_get_what_ours_get():
    for quick in (True, False):
        some = study_jobs(quick)
        peers = [j for j in some if j.method == "peers"]
        assert peers and all(j.dtype == "float32" for j in peers)
        for peer in peers:
            ours = [j for j in some if (j.method, j.dtype) == ("source", "float32")]
            batches = {b for j in ours for b in j.batches}
            assert set(peer.batches) <= batches
            assert set(peer.patterns) <= {p for j in ours for p in j.patterns}
