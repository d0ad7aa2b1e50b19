"""Each fault where it is, and none where it is not."""

import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax import Flag


@pytest.fixture
def measured(rng):
    """Voltages of 60 scans of 4 slots with a contact, and grounds."""
    shape = rng.uniform(0.5, 3, (4, 64))
    v = shape + rng.normal(0, 3e-4, (60, 4, 64))
    return (v / 1.5e-4).round() * 1.5e-4, np.tile([0, 7, 56, 63], (60, 1))


def find(v, grounds, **options):
    return tx.find_faults(v.astype(np.float32), grounds, 4.5, (-5.0, 4.9998), **options)


def scans_with(faults, flag):
    return np.flatnonzero((faults.flags & flag.value).any(1)).tolist()


def test_clean_scans_have_no_fault(measured):
    faults = find(*measured)
    assert faults.good.all() and not faults.flags.any()


def test_noise_alone_is_no_fault(rng):
    v = recordings.noise(rng, 20_000, 2) * (5 / 32768)
    faults = find(v, np.tile([0, 63], (len(v), 1)))
    assert faults.good.all() and not faults.flags.any()


@pytest.mark.parametrize(
    ("value", "flag"),
    [(0.0, Flag.DEAD_CHANNEL), (1.2345, Flag.STUCK_CHANNEL), (4.9999, Flag.SATURATED)],
)
def test_channel(measured, value, flag):
    v, grounds = measured
    v[20:30, :, 5] = value
    faults = find(v, grounds)
    assert scans_with(faults, flag) == list(range(20, 30))
    assert set(np.unique(faults.flags)) == {0, flag.value}
    assert not faults.good[20:30, :, 5].any()
    assert faults.good.sum() == faults.good.size - 40


def test_slot_and_scan(measured):
    v, grounds = measured
    grounds[3, 2] = 200
    v[7] = 4.9999
    v[9, 1] = 0
    v[30:34] = v[30]
    v[40, 3, 9] = np.nan
    faults = find(v, grounds)
    assert scans_with(faults, Flag.UNKNOWN_GROUND) == [3]
    assert scans_with(faults, Flag.SATURATED) == [7]
    assert scans_with(faults, Flag.ALL_ZERO) == [9]
    assert scans_with(faults, Flag.STUCK_SCAN) == [30, 31, 32, 33]
    assert scans_with(faults, Flag.BAD_VOLTAGES) == [40]
    assert not faults.good[3, 2].any() and faults.good[3, [0, 1, 3]].all()
    assert not faults.good[7].any() and not faults.good[30:34].any()
    assert faults.good[40].sum() == 4 * 64 - 1


def test_half_of_the_channels_are_needed(measured):
    v, grounds = measured
    v[5, 1, :33] = np.nan
    v[6, 1, :32] = np.nan
    good = find(v, grounds).good
    assert not good[5, 1].any() and good[6, 1].sum() == 32


def test_voltages_without_noise(measured):
    """A static scene computed without noise repeats itself; the caller can say so."""
    v, grounds = measured
    v[:] = v[0]
    assert scans_with(find(v, grounds), Flag.STUCK_SCAN) == list(range(60))
    assert find(v, grounds, repeats=False).good.all()


def test_result_does_not_depend_on_the_stretch(measured):
    """Faults of a stretch are those of the whole, with the scans around that it needs."""
    v, grounds = measured
    v[20:30, :, 5] = 1.0
    v[40:43] = v[40]
    whole = find(v, grounds)
    for start in range(0, 60, 7):
        low, high = max(0, start - 5), min(60, start + 12)
        part = find(v[low:high], grounds[low:high])
        keep = slice(start - low, start + 7 - low)
        np.testing.assert_array_equal(part.flags[keep], whole.flags[start : start + 7])
        np.testing.assert_array_equal(part.good[keep], whole.good[start : start + 7])
