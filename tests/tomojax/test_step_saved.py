"""A step's state in a file, and what is no such file."""

import pickle

import numpy as np
import pytest

import tomojax as tx


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float32)


@pytest.fixture(scope="module")
def step(sensor):
    return tx.make_step(sensor, "source", ["boundary", "around"], contacts=1, grid=8)


@pytest.fixture(scope="module")
def volts(sensor):
    return np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0)))


def after(step, volts, state, count):
    ground = 0
    for _ in range(count):
        state, out = step(state, volts[ground], ground)
        ground = int(out.ground)
    return state, out


def test_a_saved_state_goes_on(step, volts, tmp_path) -> None:
    state, _ = after(step, volts, step.switch(step.state, "around"), 5)
    step.save(tmp_path / "state.npz", state)
    loaded = step.load(tmp_path / "state.npz")
    assert isinstance(loaded, tx.step.Packed)
    want_state, want = after(step, volts, state, 7)
    got_state, got = after(step, volts, loaded, 7)
    for one, other in zip((*want_state, *want.contacts), (*got_state, *got.contacts)):
        np.testing.assert_array_equal(one, other)
    assert [p.name for p in tmp_path.iterdir()] == ["state.npz"]


def test_a_state_is_the_tuple_that_it_says_it_is(step, volts, tmp_path) -> None:
    """Saved by NumPy, and taken back as two arrays."""
    state, _ = after(step, volts, step.state, 3)
    np.savez(tmp_path / "own.npz", *state)
    with np.load(tmp_path / "own.npz") as file:
        pair = tuple(file[name] for name in file.files)
    want, got = step(state, volts[3], 3)[1], step(pair, volts[3], 3)[1]
    np.testing.assert_array_equal(want.contacts.xy, got.contacts.xy)
    grounds = np.array([0, 15])
    replayed = step.replay(pair, volts[grounds], grounds)[1]
    np.testing.assert_array_equal(
        replayed.contacts.xy, step.replay(state, volts[grounds], grounds)[1].contacts.xy
    )
    np.testing.assert_array_equal(step.image(pair), step.image(state))
    np.testing.assert_array_equal(
        step.switch(pair, "around").whole, step.switch(state, "around").whole
    )
    step.save(tmp_path / "state.npz", pair)
    np.testing.assert_array_equal(step.load(tmp_path / "state.npz").numbers, pair[0])


def test_what_is_no_state_of_this_step(sensor, step, tmp_path) -> None:
    path = tmp_path / "state.npz"
    with pytest.raises(ValueError, match="state.npz: no state of a step"):
        step.load(path)
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(ValueError, match="state.npz: no state of a step"):
        step.load(path)
    other = tx.make_step(sensor, "source", ["boundary", "all"], contacts=1, grid=8)
    other.save(path, other.state)
    with pytest.raises(ValueError, match="policies: got boundary, all, expected boundary"):
        step.load(path)
    names = np.frombuffer(b"boundary\naround", np.uint8)
    numbers, whole = map(np.asarray, step.state)
    np.savez(path, policies=names, numbers=numbers[:-1], whole=whole)
    with pytest.raises(ValueError, match=r"numbers: got float32 .*expected float32"):
        step.load(path)
    np.savez(path, policies=names, numbers=numbers, whole=whole.astype(float))
    with pytest.raises(ValueError, match=r"whole: got float64"):
        step.load(path)


@pytest.mark.parametrize("name", ["step", "batch"])
def test_other_processes_get_it_by_pickle(sensor, step, volts, name) -> None:
    slots = volts[None, [0, 15]].astype(np.float32)
    grounds = np.array([[0, 15]])
    if name == "step":
        made = pickle.loads(pickle.dumps(step))
        one, other = (s.replay(s.state, slots[0], grounds[0])[1] for s in (step, made))
        pairs = zip(one.contacts, other.contacts)
    else:
        batch = tx.Batch(tx.method(sensor, "source", grid=16), contacts=1)
        made = pickle.loads(pickle.dumps(batch))
        assert made.devices == batch.devices
        pairs = zip(batch(slots, grounds), made(slots, grounds))
    for mine, theirs in pairs:
        np.testing.assert_array_equal(mine, theirs)
