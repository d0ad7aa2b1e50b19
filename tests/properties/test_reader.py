"""Whatever a file holds: a recording that is what was written, or one line why not."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
import recordings
from hypothesis import example, given, HealthCheck, settings, strategies as st

import tomojax as tx

MANY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def attempt(write):
    """What the reader makes of what `write(path)` leaves: a copy of it all, or None."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.h5"
        write(path)
        try:
            with tx.open_recording(path) as recording:
                return recording.read(0, recording.scans), recording.rows_after_gaps()
        except ValueError as error:
            words = str(error)
            assert words.startswith(f"{path}: ") and "\n" not in words
            return None


@MANY
@given(
    scans=st.integers(1, 20),
    slots=st.integers(1, 5),
    dtype=st.sampled_from(["i1", "i2", "u2", "i4"]),
    chunks=st.booleans(),
    lost=st.lists(st.integers(1, 4), max_size=4),
    seed=st.integers(0, 2**31),
)
def test_what_is_valid_is_read_exactly(scans, slots, dtype, chunks, lost, seed):
    rng = np.random.default_rng(seed)
    top = min(np.iinfo(dtype).max, 30_000)
    codes = rng.integers(0, top, (scans, slots, 64)).astype(dtype)
    ground = rng.integers(0, 256, (scans, slots)).astype(np.uint8)
    # Gaps before distinct rows, with numbers that count the lost scans too.
    rows = np.sort(rng.choice(scans + 1, min(len(lost), scans + 1), replace=False))
    count = np.array(lost[: len(rows)], int)
    number = rows + np.concatenate([[0], np.cumsum(count)[:-1]]).astype(int)[: len(rows)]
    gaps = np.stack([number, count], 1).reshape(-1, 2)
    scale = 5 / np.iinfo(dtype).max

    def write(path):
        t0 = np.arange(scans) * slots / 10e3
        recordings.write(path, codes, ground, t0=t0, gaps=gaps, scale=scale)
        if chunks:
            with h5py.File(path, "r+") as file:
                del file["v"]
                file.create_dataset("v", data=codes, chunks=True, compression="gzip")

    found = attempt(write)
    assert found is not None
    read, after = found
    np.testing.assert_array_equal(read.voltages, (codes * scale).astype(np.float32))
    np.testing.assert_array_equal(read.grounds, ground)
    np.testing.assert_array_equal(after, rows)


anything = st.one_of(
    st.integers(-(2**31), 2**31),
    st.floats(),
    st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=8),
    st.lists(st.floats(), max_size=3),
    st.binary(max_size=4).filter(lambda b: b"\0" not in b),
)


@MANY
@given(name=st.sampled_from(sorted(recordings.ATTRIBUTES)), value=anything)
@example(name="scale", value=1e304)  # a voltage per code, but none of a code
def test_any_attribute(name, value):
    """Accepted only where it is a plausible value; then it is the one that is used."""
    codes = recordings.noise(np.random.default_rng(0), 3)
    found = attempt(lambda path: recordings.write(path, codes, **{name: value}))
    ignored = ("notes", "settle_delay", "convert_period")
    if found is None or name in ignored:
        return
    if name in ("schema", "units"):
        assert value == recordings.ATTRIBUTES[name]
        return
    numbers = np.asarray(value, float).ravel()
    assert np.isfinite(numbers).all() and numbers.size == (2 if name == "size" else 1)
    if name in ("scale", "offset"):
        want = (codes * float(numbers[0])) if name == "scale" else None
        if want is not None:
            np.testing.assert_array_equal(found[0].voltages, want.astype(np.float32))
    elif name not in ("drive_voltage", "ground_resistance"):
        assert (numbers > 0).all()


shapes = st.lists(st.integers(0, 5), min_size=0, max_size=4)


@MANY
@given(
    name=st.sampled_from(["v", "ground", "t0", "gaps", "electrode_xy"]),
    shape=shapes,
    dtype=st.sampled_from(["i1", "u1", "i2", "i8", "f4", "f8", "S3", "?"]),
)
def test_any_dataset(name, shape, dtype):
    """Of random shape and type: read where it fits the others, refused otherwise."""
    codes = recordings.noise(np.random.default_rng(0), 3)
    value = np.zeros(shape, dtype)
    if name == "t0" and value.ndim == 1 and dtype[0] in "fiu":
        value = (np.arange(len(value)) * 2e-4).astype(dtype)
    found = attempt(lambda path: recordings.write(path, codes, **{name: value}))
    if found is None:
        return
    fits = {
        "ground": shape == [3, 2] and dtype[0] in "iu",
        "t0": shape == [3] and dtype[0] in "fiu",
        "gaps": shape[1:] == [2] or 0 in shape,
    }
    assert fits.get(name, False)


@MANY
@given(cut=st.floats(0, 1))
@example(cut=0.0005)  # within the first twelve bytes
def test_cut_off(cut):
    """As a crash or an ended copy leaves a file.

    Zeros or other bytes within HDF5's own structures are not tried: the HDF5 library may
    then never come back.
    """
    codes = recordings.noise(np.random.default_rng(0), 30)
    whole = False

    def write(path):
        nonlocal whole
        recordings.write(path, codes)
        content = path.read_bytes()
        kept = content[: int(cut * len(content))]
        whole = len(kept) == len(content)
        path.write_bytes(kept)

    found = attempt(write)
    assert (found is not None) == whole
