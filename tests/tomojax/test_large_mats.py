"""Large mats within memory, and what grounds of a step share."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import tomojax as tx
from tomojax.sensor import make_field

MATS = Path(__file__).parents[1] / "benchmarks" / "mats.py"


def sensor(nx: int = 4, ny: int = 4) -> tx.Sensor:
    return tx.Sensor.grid(nx, ny, divisions=(32, 32))


@pytest.mark.long
def test_a_mat_of_384_electrodes_takes_little_memory():
    words = [sys.executable, MATS, "--here", "--mat", "12x32", "--method", "source"]
    # As a user's process: what LLVM does not optimise here needs more memory.
    own = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    done = subprocess.run(words, capture_output=True, text=True, check=True, env=own)
    row = json.loads(done.stdout.splitlines()[-1])
    assert row["found"] == 2 and max(row["place_mm"]) < 1  # an eighth of the pitch
    assert row["memory_GB"] < 2


@pytest.mark.long
def test_grounds_of_a_step_share_what_they_can():
    """What is shared, less a ground's own part, is what the ground has by itself."""
    method = tx.method(sensor(), "source", grid=16)
    good, lam = np.arange(16) != 5, method.choose_lambda([])
    each = method.prepare_each(good, lam)
    for ground in (0, 5, 9):
        shared, own = each[ground], method.prepare(np.array([ground]), good[None], lam)
        assert shared.columns is each[1].columns and shared.scaled is each[1].scaled
        columns = shared.columns - shared.less[0] @ shared.less[1]
        np.testing.assert_allclose(columns, own.columns, atol=1e-5)
        scaled = shared.scaled * shared.sharp.ravel()
        np.testing.assert_allclose(scaled, own.scaled, rtol=1e-5, atol=1e-5)
        volts = np.asarray(
            tx.voltages(sensor(), tx.Disc([0.03, 0.05], 0.006, 1.0), [ground])
        )
        volts = np.where(good, volts, 0)
        one, other = (
            jax.jit(lambda v, p=p: method.estimate(p, v, 2))(volts) for p in (shared, own)
        )
        assert 0 < int(one.contacts.count) == int(other.contacts.count)
        np.testing.assert_allclose(one.contacts.xy[0], other.contacts.xy[0], atol=1e-6)
        assert int(one.flags) == int(other.flags)


def test_the_basis_is_orthonormal_and_strongest_first():
    method = tx.method(sensor(), "source", grid=16)
    basis, shared = np.asarray(method.basis, float), method.shared
    np.testing.assert_allclose(basis @ basis.T, np.eye(16), atol=1e-5)
    lengths = np.linalg.norm(shared, axis=0)
    assert (np.diff(lengths) <= 1e-9 * lengths[0]).all()
    values = np.linalg.svd(shared, compute_uv=False)
    np.testing.assert_allclose(values, lengths, rtol=1e-6)


@pytest.mark.long
def test_a_long_sheet_has_square_pixels():
    method = tx.method(tx.Sensor.grid(8, 16), "source")
    assert method.shape == (32, 64)
    np.testing.assert_allclose(method.cell, method.cell[0], rtol=1e-5)


def test_what_takes_more_memory_than_there_is_says_so_before():
    with pytest.raises(ValueError, match=r"linear: got arrays of \d+ GB, expected at most"):
        tx.method(tx.Sensor.grid(48, 48, divisions=(192, 192)), "linear")
    # Of `points`: 0.2 MB for each electrode and more.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tomojax._require.memory", lambda: 1e6)
        with pytest.raises(ValueError, match="tables of 16 electrodes: got arrays of"):
            make_field(sensor())
