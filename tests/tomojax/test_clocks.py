"""Recordings of rigs whose clocks fall, stand, jump and begin anew: all are read."""

import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax import Flag
from tomojax.recordings import info

DT, N = 2e-4, 3000
TRUE = DT * np.arange(N)
WRAP = 2**32 * 1e-6


def falls_once(t):
    return t - 0.01 * (np.arange(N) >= 1200)


def begins_anew(t):
    return (t + WRAP - 0.2) % WRAP


def coarse(t):
    return np.floor(t * 1e3) / 1e3


def bursts(t):
    last = (np.arange(N) // 50 + 1) * 50
    return DT * last + 3e-5 * (np.arange(N) % 50)


def back_to_1970(t):
    return t + 1.7e9 * (np.arange(N) < 900)


def jumps_and_returns(t):
    return t + 7.0 * ((np.arange(N) >= 900) & (np.arange(N) < 950))


def falls_and_returns(t):
    return t - 7.0 * ((np.arange(N) >= 900) & (np.arange(N) < 950))


def set_forward(t):
    return t + 1.7e9 * (np.arange(N) >= 900)


def stands(t):
    return np.zeros(N)


def backwards(t):
    return t[::-1]


def junk(t):
    return np.random.default_rng(0).uniform(-1e9, 1e9, N)


def milliseconds(t):
    return 1e3 * t


def one_nan(t):
    return np.where(np.arange(N) == 7, np.nan, t)


def all_nan(t):
    return np.full(N, np.nan)


def coarse_and_anew(t):
    return coarse(begins_anew(t))


# A clock, and by how much the mended times may be off, in seconds, beside a constant.
CLOCKS = {
    falls_once: 1e-6,
    begins_anew: 1e-6,
    coarse: 1e-3,
    bursts: 0.02,
    back_to_1970: 1e-6,
    jumps_and_returns: 1e-6,
    falls_and_returns: 1e-6,
    set_forward: 1e-6,
    stands: 1e-9,
    backwards: 1e-9,
    junk: 1e-9,
    milliseconds: 1e-9,
    one_nan: 1e-6,
    all_nan: 1e-9,
    coarse_and_anew: 2e-3,
}


@pytest.mark.parametrize("clock", CLOCKS, ids=lambda clock: clock.__name__)
def test_clocks_are_put_right_and_said(tmp_path, rng, clock):
    path = recordings.write(
        tmp_path / "a.h5", recordings.noise(rng, N), t0=clock(TRUE.copy())
    )
    with tx.open_recording(path) as recording:
        times = recording.read(0, N).t0
        assert len(recording.mended) >= 1 and "t0: " in recording.mended[0]
        flags = tx.recordings.read_chunk(recording, 0, N).flags & Flag.CLOCK_MENDED
        assert recording.interval == pytest.approx(DT, rel=0.01)
        summary = info.summary(recording)
        rows = info.faults(recording)
    assert (np.diff(times) > 0).all()
    assert np.abs(times - TRUE - (times - TRUE).mean()).max() <= CLOCKS[clock]
    # A row is flagged where its time is not what the clock said.
    np.testing.assert_array_equal(flags != 0, times != clock(TRUE.copy()))
    assert [r["scans"] for r in rows if r["fault"] == "CLOCK_MENDED"] == [
        np.count_nonzero(flags)
    ]
    text = info.text(path, summary, rows)
    assert "put right: t0: " in text and "CLOCK_MENDED" in text


def test_a_sound_clock_is_left_alone(tmp_path, rng):
    t0 = 5.0 + TRUE * 1.0003 + 1e-3 * (np.arange(N) > 50)
    path = recordings.write(tmp_path / "a.h5", recordings.noise(rng, N), t0=t0)
    with tx.open_recording(path) as recording:
        np.testing.assert_array_equal(recording.read(0, N).t0, t0)
        assert recording.mended == ()
        assert not (
            tx.recordings.read_chunk(recording, 0, N).flags & Flag.CLOCK_MENDED
        ).any()


def test_lost_scans_count_where_a_clock_stands(tmp_path, rng):
    path = recordings.write(
        tmp_path / "a.h5",
        recordings.noise(rng, 9),
        t0=np.zeros(9),
        gaps=np.array([[4, 10]]),
    )
    with tx.open_recording(path) as recording:
        np.testing.assert_allclose(
            np.diff(recording.read(0, 9).t0)[[2, 3, 4]], [DT, 11 * DT, DT]
        )


def test_rate_twice_and_half(tmp_path, rng):
    for rate in (2.0, 0.49, 300.0):
        path = recordings.write(tmp_path / "a.h5", recordings.noise(rng, N), t0=rate * TRUE)
        with tx.open_recording(path) as recording:
            assert bool(recording.mended) == (rate != 2.0)


@pytest.mark.parametrize(
    "gaps", [[[99, 1]], [[50, 2], [10, 3]], [[10, 5], [12, 1]], [[10, 5], [10, 5]]]
)
def test_gaps_in_any_order(tmp_path, rng, gaps):
    path = recordings.write(
        tmp_path / "a.h5", recordings.noise(rng, 80), gaps=np.array(gaps)
    )
    with tx.open_recording(path) as recording:
        assert recording.gaps[:, 1].sum() == np.sum(gaps, 0)[1]
        assert "gaps: " in recording.mended[0]
        rows = recording.rows_after_gaps()
        assert (np.diff(rows) >= 0).all() and rows.min() >= 0 and rows.max() <= 80
