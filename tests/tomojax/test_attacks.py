"""Rigs with a short, a leak, a film, crosstalk or loose electrodes; and coarse codes."""

import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
import recordings
from faulty import grid

import tomojax as tx
from bench import attacked
from tomojax.bringup.signs import find_signs

FAULT, DOUBT = int(tx.Flag.RIG_FAULT), int(tx.methods.DOUBT)


@pytest.fixture(scope="module")
def sensor() -> tx.Sensor:
    return grid(6, 6)


@pytest.fixture(scope="module")
def lone(sensor):
    return attacked.lone(sensor, 11, rigs=1, each=16)


@pytest.fixture(scope="module")
def batch(sensor):
    return tx.Batch(tx.method(sensor, "points", grid=16), contacts=2, images=False)


CORNERS = np.array([0, 35])


def read(scenes, attack, grounds=CORNERS):
    return np.stack(
        [attack(s, grounds, np.random.default_rng(k)) for k, s in enumerate(scenes)]
    )


ATTACKS = {
    "short to the grounded corner": attacked.short_of(0, 6),
    "short": attacked.short_of(14, 15),
    "crosstalk": attacked.crosstalk(0.01, (-1,)),
    "leak": attacked.leaky(1e3),
    "film": attacked.film(5e4),
    "lifted": attacked.lifted(1e7),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_a_fault_makes_no_far_contact_up(lone, batch, name):
    rows = batch(read(lone, ATTACKS[name]), np.tile(CORNERS, (len(lone), 1)))
    xy = np.array([scene.xy[0] for scene in lone])
    off = np.hypot(*np.moveaxis(rows.contact_xy - xy[:, None], -1, 0))
    far = np.nan_to_num(off, nan=0.0).max(1) > 0.03
    assert not (far & (rows.flags & DOUBT == 0)).any()
    # No contact, doubted, is as far off as can be.
    assert np.median(np.nan_to_num(off[:, 0], nan=np.inf)) < 1e-3
    if name not in ("crosstalk", "short"):
        assert (rows.flags & FAULT > 0).mean() > 0.6


def test_contacts_of_a_sound_rig_are_no_faults(sensor, lone, batch):
    pairs = attacked.pairs(sensor, 12, rigs=1, each=6, apart=0.03)
    alone, two = (
        batch(read(s, attacked.sound), np.tile(CORNERS, (len(s), 1))) for s in (lone, pairs)
    )
    assert (alone.contact_count == 1).all() and not (alone.flags & FAULT).any()
    assert (two.contact_count == 2).sum() >= 5 and not (two.flags & FAULT).any()


@pytest.mark.long
@pytest.mark.parametrize("slots", [2, 6])
def test_source_doubts_what_a_strong_contact_may_hide(sensor, slots):
    method = tx.method(sensor, "source")
    source = tx.Batch(method, method.choose_lambda([]), 3, images=False)
    grounds = np.array([0, 35, 5, 30, 14, 21])[:slots]

    def rows_of(scenes):
        volts = read(scenes, attacked.sound, grounds)
        return source(volts, np.tile(grounds, (len(scenes), 1)))

    two_pitches = 2 * sensor.mean_pitch
    pairs = attacked.pairs(sensor, 12, 2, 12, apart=two_pitches, ratio=30.0)
    alone, two = rows_of(attacked.lone(sensor, 31, rigs=4, each=6)), rows_of(pairs)
    assert ((two.contact_count == 2) | (two.flags & DOUBT > 0)).mean() > 0.9
    assert (alone.contact_count == 1).all() and (alone.flags & DOUBT > 0).mean() < 0.1


def recording_of(sensor, volts):
    return tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor), volts, CORNERS)


def test_channels_that_read_the_same_are_named(sensor, lone):
    found = find_signs(recording_of(sensor, read(lone, attacked.short_of(14, 15))))
    assert [s.text[:18] for s in found if s.kind == "alike"] == ["channels 14 and 15"]
    assert not find_signs(recording_of(sensor, read(lone, attacked.sound)))


def test_a_held_contact_between_two_electrodes_is_no_short(sensor, lone):
    rng = np.random.default_rng(0)
    volts = np.stack([attacked.sound(lone[0], CORNERS, rng) for _ in range(60)])
    volts[..., 15] = volts[..., 14] + 1e-4 * rng.normal(size=volts.shape[:2])
    assert not [s for s in find_signs(recording_of(sensor, volts)) if s.kind == "alike"]


@pytest.mark.parametrize("bits", [6, 8, 10])
def test_coarse_codes_are_used(lone, bits):
    held = [scene for scene in lone for _ in range(3)]
    volts, step = read(held, attacked.bits(bits)), 5.0 / 2**bits
    rails = 0.0, (2**bits - 1) * step
    grounds = np.tile(CORNERS, (len(held), 1))
    faults = tx.find_faults(volts, grounds, 4.5, rails, resolution=step)
    assert faults.good.any((1, 2)).all() and faults.good.mean() > 0.99


def test_a_rail_within_the_sheets_potentials_saturates():
    volts = np.random.default_rng(0).uniform(0.5, 4, (3, 2, 16))
    volts[1, 0, :3] = 4.1
    faults = tx.find_faults(volts, np.array([[0, 15]] * 3), 4.5, (-5.0, 4.1))
    assert faults.flags[1, 0] == tx.Flag.SATURATED and not faults.good[1, 0, :3].any()


FORKED = """
import multiprocessing, jax.numpy as jnp
jnp.ones(3).sum().block_until_ready()
def work(_):
    try:
        import tomojax
    except RuntimeError as error:
        return str(error)
print(multiprocessing.get_context("fork").Pool(1).map_async(work, [1]).get(60)[0])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_fork_of_jax_is_told_at_once():
    run = [sys.executable, "-W", "ignore", "-c", FORKED]
    told = subprocess.run(run, capture_output=True, text=True, timeout=120).stdout
    assert "spawn" in told


def test_packed_by_plugins(tmp_path, rng):
    plugin = pytest.importorskip("hdf5plugin")
    plain = recordings.write(tmp_path / "plain.h5", recordings.noise(rng, 20))
    for pack in (plugin.Blosc(), plugin.Zstd(), plugin.Bitshuffle()):
        path = tmp_path / f"{type(pack).__name__}.h5"
        with h5py.File(plain) as old, h5py.File(path, "w") as new:
            for name in old:
                words = dict(chunks=True, **pack) if name == "v" else {}
                new.create_dataset(name, data=old[name][()], **words)
            new.attrs.update(old.attrs)
        volts = [tx.open_recording(p).read(0, 20).voltages for p in (plain, path)]
        np.testing.assert_array_equal(*volts)
