"""Current between electrodes on a rim: the electrode model, and levels of conductance."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import skfem
from scipy import sparse
from scipy.sparse.linalg import spsolve
from skfem.helpers import dot, grad

from tomojax.ert import disc_model, Levels, rim_model

ROOT = Path(__file__).parents[2]
COUNT = 8
PAIRS = np.eye(COUNT) - np.roll(np.eye(COUNT), 3, 0)


def even(model) -> np.ndarray:
    return np.ones(len(model.areas))


def test_disc_is_its_series() -> None:
    # Contacts that resist much let current in evenly along each electrode. Potentials are
    # then ρ/π·Σ cos(nθ)·sinc²(nα)/n, averaged over electrodes of half angle α.
    half, order = np.pi / 2 / COUNT, np.arange(1, 20_000)
    turn = 2 * np.pi * np.arange(COUNT) / COUNT
    each = np.cos(np.outer(turn, order)) @ (np.sinc(order * half / np.pi) ** 2 / order)
    series = each[np.subtract.outer(np.arange(COUNT), np.arange(COUNT)) % COUNT] / np.pi
    gauge = np.eye(COUNT) - 1 / COUNT
    errors = []
    for spacing in (0.02, 0.006):
        model = disc_model(0.1, COUNT, spacing, first=0.3)
        table = model.transfer(even(model), 100.0).table
        ends = model.nodes[model.sides]
        long = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        contact = np.diag(100.0 / np.bincount(model.under, long))
        errors.append(abs(table - gauge @ (series + contact) @ gauge).max() / series.max())
    assert errors[1] < 0.012
    assert errors[1] < errors[0] / 2.5  # it converges


def test_voltages_are_scikit_fems() -> None:
    # Quadratic elements on a mesh of another structure, 64 sides around, contacts that
    # resist little, and conductance that rises along x.
    mesh = skfem.MeshTri.init_circle(4, smoothed=True)
    turn = np.arctan2(*mesh.p[::-1, mesh.boundary_nodes()])
    assert len(turn) == 64
    inside = skfem.Basis(mesh, skfem.ElementTriP2())
    contact, size = 0.2, inside.N

    @skfem.BilinearForm
    def laplace(u, v, w):
        return (2 + w.x[0]) * dot(grad(u), grad(v))

    @skfem.BilinearForm
    def both(u, v, _):
        return u * v / contact

    @skfem.LinearForm
    def one(v, _):
        return v / contact

    matrix = sparse.lil_array((size + COUNT, size + COUNT))
    matrix[:size, :size] = laplace.assemble(inside)
    matrix[size, size] = 1  # to ground: nothing flows there
    edges = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, edges]].mean(1)
    place = np.arctan2(middle[1], middle[0]) % (2 * np.pi) * COUNT / (2 * np.pi)
    for e in range(COUNT):
        under = skfem.FacetBasis(
            mesh, skfem.ElementTriP2(), facets=edges[abs(place - 0.25 - e) < 0.25]
        )
        matrix[:size, :size] += both.assemble(under)
        row = one.assemble(under)
        matrix[size + e, :size] = matrix[:size, size + e] = -row
        matrix[size + e, size + e] += row.sum()
    currents = np.zeros((size + COUNT, COUNT))
    currents[size:] = np.eye(COUNT) - 1 / COUNT
    want = spsolve(matrix.tocsc(), currents)[size:]
    # The same polygon; electrodes cover the first half of each eighth.
    corner = 2 * np.pi * np.arange(64) / 64
    side = 2 * np.sin(np.pi / 64)
    outline = np.stack([np.cos(corner), np.sin(corner)], 1)
    spans = 8 * side * np.arange(COUNT)[:, None] + side * np.array([0, 4])
    model = rim_model(outline, spans, 0.04)
    got = model.transfer(2 + model.nodes[model.triangles].mean(1)[:, 0], contact).table
    np.testing.assert_allclose(got, want - want.mean(0), atol=0.01 * want.max())


def test_slopes_are_differences(rng) -> None:
    letter = 1e-2 * np.array([[0, 0], [16, 0], [16, 8], [8, 8], [8, 16], [0, 16]])
    model = rim_model(letter, np.arange(10)[:, None] * 0.06 + [0.01, 0.03], 0.02)
    assert np.isclose(model.areas.sum(), 0.0192, rtol=1e-6)
    sigma = rng.uniform(0.5, 2, len(model.areas))
    change = rng.normal(size=len(sigma))
    slopes = model.slopes(model.transfer(sigma, 0.01).fields) @ change
    # 1e-5: rounding, 1e-16/1e-5, and the third derivative, 1e-10, are both small.
    up, down = (model.transfer(sigma + h * change, 0.01).table for h in (1e-5, -1e-5))
    a, b = np.triu_indices(10)
    np.testing.assert_allclose(slopes, (up - down)[a, b] / 2e-5, rtol=1e-6, atol=1e-6)


@pytest.fixture(scope="module")
def tank() -> tuple[Levels, np.ndarray, np.ndarray]:
    """A small tank, told on a coarse mesh, and the readings of a finer one, 16 electrodes.

    The rest conducts 5 % less than in the reference.
    """
    electrodes = 16
    fine, coarse = (disc_model(0.1, electrodes, s) for s in (0.005, 0.009))
    x, y = fine.nodes[fine.triangles].mean(1).T
    objects = np.where(np.hypot(x - 0.04, y - 0.02) < 0.025, 200.0, 1.0)
    objects = np.where(np.hypot(x + 0.05, y + 0.01) < 0.025, 0.005, objects)
    pairs = np.eye(electrodes) - np.roll(np.eye(electrodes), 5, 0)
    read = np.eye(electrodes) - np.roll(np.eye(electrodes), 1, 0)
    before, after = (
        (read @ fine.transfer(s, 2e-3).table @ pairs.T).T for s in (1.0 + 0 * x, objects)
    )
    return Levels(coarse, pairs, read, before / 0.7), before / 0.7, after / 0.7 / 0.95


def test_two_kinds_are_found(tank) -> None:
    levels, _, volts = tank
    found = levels(volts)
    kinds, (x, y) = found.classes(), levels.model.nodes.T
    area = np.bincount(levels.model.triangles.ravel(), np.repeat(levels.model.areas / 3, 3))
    for kind, place in ((1, (-0.05, -0.01)), (2, (0.04, 0.02))):
        truth = np.hypot(x - place[0], y - place[1]) < 0.025
        shared = area[truth & (kinds == kind)].sum() / area[truth | (kinds == kind)].sum()
        assert shared > 0.75
    assert abs(found.rest - 0.95) < 0.03
    assert abs(levels.rest_conductance - 0.7) < 0.02


def test_nothing_is_found_in_nothing(tank, rng) -> None:
    levels, reference, _ = tank
    noise = rng.normal(size=reference.shape) * 1e-4 * abs(reference).max()
    found = levels(0.98 * reference + noise)
    assert not found.classes().any()
    assert abs(found.rest - 1 / 0.98) < 2e-3


def test_readings_that_are_missing_are_left_out(tank) -> None:
    levels, _, volts = tank
    volts = volts.copy()
    volts[:, 3], volts[5] = np.nan, np.nan
    found = levels(volts)
    assert set(found.classes()) == {0, 1, 2}


def test_bad_input_is_named() -> None:
    model = disc_model(0.1, COUNT, 0.02)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    with pytest.raises(ValueError, match="spans"):
        rim_model(square, np.array([[0.1, 0.5], [0.4, 0.8]]), 0.1)
    with pytest.raises(ValueError, match="inject: got currents left over"):
        Levels(model, np.eye(COUNT), PAIRS, np.ones((COUNT, COUNT)))
    with pytest.raises(ValueError, match="inject"):
        Levels(model, PAIRS[:, 1:], PAIRS, np.ones((COUNT, COUNT)))
    with pytest.raises(ValueError, match="cover"):
        disc_model(0.1, COUNT, 0.02, cover=1.0)


@pytest.mark.long
def test_tank_that_was_measured(shared_data, tmp_path) -> None:
    script = ROOT / "tests" / "benchmarks" / "tank.py"
    words = [shared_data / "tank", "--cases", "1", "--output", tmp_path]
    subprocess.run([sys.executable, script, *map(str, words)], check=True)
    (row,) = json.loads((tmp_path / "tank.json").read_text())["rows"]
    assert row["score"] > 0.75
    assert (tmp_path / "tank.png").is_file()
