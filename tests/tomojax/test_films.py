"""Rows that begin where another ends: the same contacts, however a recording is cut."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import tomojax as tx

SCANS, GROUNDS = 70, [0, 15]
SETTINGS = dict(contacts=3, grid=16, images=False)


@pytest.fixture(scope="module")
def recording() -> tx.recordings.ArrayRecording:
    """A contact that moves, one that comes beside it, and neither; noise.

    Voltages are the model's own: what is tested is whether rows agree with each other.
    """
    sensor = tx.Sensor.grid(4, 4, divisions=(32, 32))
    rng = np.random.default_rng(3)
    volts = []
    for k in range(SCANS):
        # 0.3 m/s, a scan of two slots each 0.2 ms.
        shapes = [tx.Disc([0.02 + 6e-5 * k, 0.03], 0.006, 0.1)]
        if k > 27:
            shapes.append(tx.Disc([0.06, 0.055 - 3e-5 * k], 0.005, 0.1))
        if 50 < k < 56:
            shapes = []
        clean = tx.voltages(sensor, tx.Scene(*shapes), GROUNDS)
        volts.append(clean + rng.normal(0, 2e-4, clean.shape))
    rig = tx.recordings.Rig.of(sensor)
    return tx.recordings.ArrayRecording(rig, np.array(volts), GROUNDS)


def rows(recording, path: Path, **given) -> dict[str, np.ndarray]:
    settings = tx.results.Settings(**(SETTINGS | given))
    tx.reconstruct_recording(recording, path, settings)
    with h5py.File(path) as file:
        return {
            name: file[name][()] for name in file if isinstance(file[name], h5py.Dataset)
        }


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    for name in ("contact_count", "flags"):
        np.testing.assert_array_equal(one[name], other[name])
    np.testing.assert_allclose(one["contact_xy"], other["contact_xy"], atol=1e-6)


@pytest.mark.parametrize(
    "method, films, sizes",
    [
        pytest.param(method, films, (1, 7, 64, 1000), marks=pytest.mark.long)
        for method in ("points", "auto")
        for films in (True, False)
    ],
)
def test_no_row_depends_on_chunks(recording, tmp_path, method, films, sizes) -> None:
    found = [
        rows(recording, tmp_path / f"{size}.h5", method=method, films=films, chunk=size)
        for size in sizes
    ]
    for other in found[:-1]:
        assert_same(found[-1], other)


@pytest.mark.parametrize(
    "rate", [pytest.param(rate, marks=pytest.mark.long) for rate in ("scan", "slot")]
)
def test_a_film_finds_what_a_search_finds(recording, tmp_path, rate) -> None:
    searched, film = (
        rows(recording, tmp_path / f"{films}.h5", method="points", films=films, rate=rate)
        for films in (False, True)
    )
    if rate == "scan":
        assert set(searched["contact_count"]) == {0, 1, 2}
    np.testing.assert_array_equal(searched["contact_count"], film["contact_count"])
    # Where the search ends is known to a part of the errors (0.3 mm).
    np.testing.assert_allclose(searched["contact_xy"], film["contact_xy"], atol=2e-4)


@pytest.mark.long
def test_resumed_rows_are_the_same(recording, tmp_path) -> None:
    given = dict(method="points", films=True, chunk=16, contacts=1)
    whole = rows(recording, tmp_path / "whole.h5", **given)
    settings = tx.results.Settings(**(SETTINGS | given))

    def interrupt(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    out = tmp_path / "part.h5"
    with pytest.raises(KeyboardInterrupt):
        tx.reconstruct_recording(recording, out, settings, progress=interrupt)
    tx.reconstruct_recording(recording, out, settings, resume=True)
    with h5py.File(out) as file:
        np.testing.assert_array_equal(file["contact_xy"][()], whole["contact_xy"])


def test_chunks_are_whole_films(recording, tmp_path) -> None:
    def chunk(number: int, **given) -> int:
        path = tmp_path / f"{number}.h5"
        rows(recording, path, chunk=100, contacts=1, **given)
        with h5py.File(path) as file:
            return json.loads(file.attrs["configuration"])["chunk"]

    # A fifth of a pitch of 20 mm at 1 m/s is 4 ms: twenty scans, and sixteen at most.
    assert chunk(1, method="points", films=True) == 112
    # By default only a long recording has films.
    assert chunk(2, method="points") == 100
    assert chunk(3, method="source", films=True) == 100
