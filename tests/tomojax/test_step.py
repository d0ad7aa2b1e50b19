"""The compiled step, slot by slot, on a rig that is not ours."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rig import Rig

import tomojax as tx
from tomojax import Flag
from tomojax.events import EventFinder
from tomojax.kernels.contacts import field_at

POLICIES = ("around_contacts", "information", "around", "cop_line", "all", "edge")
AT_ONCE = [(0.035, 0.04), (0.13, 0.055), (0.085, 0.12)]
PLACE, OTHER = np.array([0.052, 0.071]), np.array([0.118, 0.103])


@pytest.fixture(scope="module")
def rig():
    return Rig(np.random.default_rng(21))


@pytest.fixture(scope="module")
def scenes(rig):
    """Name: measured voltages of all grounds, float32."""
    one, other = rig.disc(PLACE, 0.006), rig.disc(OTHER, 0.005)
    contacts = {
        "nothing": [],
        "one": [(one, 1e-4)],
        "there": [(other, 1e-4)],
        "two": [(one, 1e-4), (other, 6e-5)],
        "faint": [(one, 1e-4), (other, 8e-6)],
    }
    at_once = [rig.disc(xy, 0.006) for xy in AT_ONCE]
    contacts["at once"] = [(disc, 1e-4) for disc in at_once]
    exact = {name: rig.scene(*some)[0] for name, some in contacts.items()}
    return {name: rig.measure(v).astype(np.float32) for name, v in exact.items()}


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))


@pytest.fixture(scope="module")
def step(sensor):
    return tx.make_step(sensor, "follow", POLICIES)


@pytest.fixture(scope="module")
def lone(sensor):
    """A step that follows one contact at most, by any policy; *Around* is the first."""
    policies = ("around", *(p for p in tx.step.POLICIES if p != "around"))
    return tx.make_step(sensor, "follow", policies, contacts=1, grid=24)


def run(step, state, volts, count, ground=0):
    """So many slots, each with the ground that the one before asked for."""
    outputs = []
    for _ in range(count):
        state, out = step(state, volts[ground], ground)
        outputs.append(out)
        ground = int(out.ground)
    return state, outputs


def off(out, place):
    """How far the strongest contact is from there, mm."""
    return 1e3 * float(np.hypot(*(np.asarray(out.contacts.xy[0]) - place)))


@pytest.mark.parametrize("policy", POLICIES)
def test_a_contact_is_found_and_followed(step, scenes, policy):
    _, outs = run(step, step.switch(step.state, policy), scenes["one"], 20)
    assert all(int(out.contacts.count) == 1 and int(out.flags) == 0 for out in outs)
    assert off(outs[1], PLACE) < 1.5
    assert np.median([off(out, PLACE) for out in outs[9:]]) < 0.6
    last = outs[-1].contacts
    found = np.median([float(out.contacts.conductance[0]) for out in outs[9:]])
    assert abs(found / 1e-4 - 1) < 0.1
    assert 0 < float(last.covariance[0, 0]) < 1e-6


def test_a_jump_is_followed_within_three_slots(step, scenes):
    state, outs = run(step, step.state, scenes["one"], 12)
    _, outs = run(step, state, scenes["there"], 3, int(outs[-1].ground))
    assert off(outs[-1], OTHER) < 1 and int(outs[-1].contacts.count) == 1


def test_one_more_and_one_less(step, scenes):
    state, outs = run(step, step.state, scenes["one"], 12)
    state, outs = run(step, state, scenes["two"], 20, int(outs[-1].ground))
    contacts = outs[-1].contacts
    assert int(contacts.count) == 2
    places = np.asarray(contacts.xy)
    assert np.hypot(*(places - [PLACE, OTHER]).T).max() < 1e-3  # strongest first
    state, outs = run(step, state, scenes["one"], 8, int(outs[-1].ground))
    assert int(outs[-1].contacts.count) == 1 and off(outs[-1], PLACE) < 1
    _, outs = run(step, state, scenes["nothing"], 4, int(outs[-1].ground))
    assert int(outs[-1].flags) == Flag.NO_CONTACT


@pytest.mark.long
def test_three_that_come_at_once_are_three(sensor, scenes):
    """And no fewer before: a touch-down each."""
    step = tx.make_step(sensor, "follow", [[0, 63, 7]], contacts=4)
    state, outs = run(step, step.state, scenes["at once"], 20)
    _, then = run(step, state, scenes["nothing"], 12, int(outs[-1].ground))
    assert {int(out.contacts.count) for out in outs[4:]} == {3}
    xy = np.asarray(outs[-1].contacts.xy)[:3]
    apart = np.hypot(*(xy[:, None] - np.array(AT_ONCE)).transpose(2, 0, 1))
    assert apart.min(0).max() < 1e-3
    finder, found = EventFinder.of_rows(pitch=0.02, interval=1e-4), []
    for k, out in enumerate(outs + then):
        n = int(out.contacts.count)
        told = out.contacts.xy[:n], out.contacts.conductance[:n], int(out.flags)
        found += finder.row(1e-4 * k, *told)[1]
    assert [e.kind for e in found].count("touch_down") == 3


def test_what_is_wrong_is_flagged_and_goes_on(step, scenes):
    volts, nan = scenes["one"], np.float32(np.nan)
    state, _ = run(step, step.state, volts, 6)
    dead = volts[9].copy()
    dead[[3, 40]] = nan
    high = volts[9].copy()
    high[5] = 9.0
    some = (
        (dead, 9, 0, Flag.BAD_VOLTAGES, 1),
        (high, 9, 0, Flag.SATURATED, 1),
        (volts[9], 9, 3, Flag.GAP, 1),
        (volts[9], 64, 0, Flag.UNKNOWN_GROUND | Flag.NO_DATA, 0),
        (volts[9], -1, 0, Flag.UNKNOWN_GROUND | Flag.NO_DATA, 0),
        (np.full(64, nan), 9, 0, Flag.BAD_VOLTAGES | Flag.NO_DATA, 0),
        (np.zeros(64), 9, 0, Flag.ALL_ZERO, None),
    )
    for v, ground, lost, flags, count in some:
        after, out = step(state, v, ground, lost)
        assert int(out.flags) & flags == flags
        assert 0 <= int(out.ground) < 64
        if count is not None:
            assert int(out.contacts.count) == count
        if flags & Flag.NO_DATA:
            assert np.isnan(out.residual)
            memories = (step._trace().packing.unpack(s).memory for s in (after, state))
            same = jax.tree.map(np.array_equal, *memories)
            assert all(jax.tree.leaves(same))
        _, out = step(after, volts[9], 9)
        assert off(out, PLACE) < 1  # what was known is still known
    assert step.traces == 1


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=pytest.mark.long) for name in ("source", "linear")]
)
def test_methods_of_the_ladder_say_what_a_batch_says(sensor, scenes, method):
    step = tx.make_step(sensor, method, ("all", "around"))
    model = tx.method(sensor, method)
    volts, grounds = scenes["two"], np.arange(64)
    rows = tx.Batch(model, model.choose_lambda([]), contacts=2)(
        volts[:, None], grounds[:, None]
    )
    _, outs = step.replay(step.state, volts, grounds)
    np.testing.assert_array_equal(outs.contacts.count, rows.contact_count)
    np.testing.assert_allclose(outs.contacts.xy, rows.contact_xy, atol=2e-5)
    np.testing.assert_allclose(outs.residual, rows.residual, rtol=1e-3)
    np.testing.assert_array_equal(outs.flags, rows.flags)
    state, _ = step(step.state, volts[7], 7)
    top = np.abs(rows.image[7]).max()
    np.testing.assert_allclose(step.image(state), rows.image[7], atol=1e-3 * top)
    dead = np.where(np.arange(64) == 3, np.nan, volts[7])
    _, out = step(state, dead, 7)
    assert int(out.flags) & Flag.NO_DATA and int(out.contacts.count) == 0
    assert step.traces == 1


@pytest.mark.parametrize(
    "method",
    [pytest.param(n, marks=pytest.mark.long) for n in ("follow", "source", "linear")],
)
def test_one_trace_under_every_policy_whatever_comes(sensor, scenes, lone, method):
    step = lone
    if method != "follow":
        step = tx.make_step(sensor, method, tx.step.POLICIES, contacts=1, grid=24)
    nan, volts, state, ground = np.float32(np.nan), scenes["one"], step.state, 0
    wrong = [
        (np.full(64, nan), 3, 0),
        (np.where(np.arange(64) == 7, nan, volts[5]), 5, 2),
        (np.full(64, 1e30), 4, 0),
        (np.zeros(64), 4, -3),
        (volts[5], 99, 1 << 30),
        (volts[5].astype(float), np.int64(-5), np.int8(1)),
        (-volts[5], 5, 0),
    ]
    for policy in step.policies:
        state = step.switch(state, policy)
        for v, g, lost in [*wrong, *((volts[k], k, 0) for k in range(4))]:
            state, out = step(state, v, g, lost)
            ground = int(out.ground)
            assert 0 <= ground < 64
    state, out = step(state, volts[ground], ground)
    assert int(out.contacts.count) == 1 and step.traces == 1


@pytest.mark.long
def test_readings_are_corrected(sensor, scenes, lone):
    rng = np.random.default_rng(4)
    zero, gain = rng.normal(0, 5e-3, 64), rng.normal(1, 0.02, 64)
    known = tx.Calibration(tuple(zero.tolist()), tuple(gain.tolist()))
    step = tx.make_step(sensor, "follow", "all", contacts=1, calibration=known)
    volts, grounds = scenes["one"][:6], np.arange(6)
    _, right = lone.replay(lone.state, volts, grounds)
    _, outs = step.replay(step.state, volts * gain + zero, grounds)
    np.testing.assert_allclose(outs.contacts.xy, right.contacts.xy, atol=2e-5)


def test_one_contact_more_than_may_be_is_doubted_in_every_slot(lone, scenes):
    """Slots that do not show it follow slots that do."""
    _, outs = run(lone, lone.state, scenes["faint"], 40)
    high = [int(out.flags) & Flag.HIGH_RESIDUAL > 0 for out in outs]
    share = [float(out.residual) / np.sqrt(np.mean(scenes["faint"] ** 2)) for out in outs]
    assert all(high[2:]) and min(share[2:]) < 0.02 < 0.03 < max(share[2:])
    _, outs = run(lone, lone.state, scenes["one"], 40)
    assert not any(int(out.flags) for out in outs)


@pytest.mark.parametrize("contacts", [2, pytest.param(3, marks=pytest.mark.long)])
def test_two_contacts_without_noise_are_not_doubted(sensor, step, contacts):
    """Nor while both contacts that may be are there: no doubt is older than the second.

    The first is on an electrode: slots that do not know of the second make it grow to the
    largest disc there is, and it has to shrink again.
    """
    fine = tx.Sensor.grid(dtype=np.float32, divisions=(64, 64))
    discs = tx.Disc([0.052, 0.071], 0.006, 1.0), tx.Disc([0.118, 0.103], 0.005, 0.6)
    volts = np.asarray(tx.voltages(fine, tx.Scene(*discs)))
    if contacts > 2:
        step = tx.make_step(sensor, "follow", "information", contacts=contacts)
    _, outs = run(step, step.switch(step.state, "information"), volts, 60)
    assert all(int(out.contacts.count) == 2 for out in outs[15:])
    assert not any(int(out.flags) for out in outs[15:])
    rest = [float(out.residual) / volts.std(1).mean() for out in outs[15:]]
    assert np.median(rest) < 0.005


def test_replay_is_the_same_and_a_state_can_be_saved(step, scenes):
    grounds = np.random.default_rng(3).integers(0, 64, 30)
    volts = np.concatenate([scenes["one"][grounds[:15]], scenes["two"][grounds[15:]]])
    lost = np.where(np.arange(30) == 20, 5, 0)
    state, outs = step.state, []
    for k in range(30):
        if k == 12:
            saved = jax.tree.map(np.array, state)
            state = jax.tree.map(jnp.asarray, saved)
        state, out = step(state, volts[k], grounds[k], lost[k])
        outs.append(out)
    end, replayed = step.replay(step.state, volts, grounds, lost)
    one = jax.tree.map(lambda *a: np.stack(a), *outs)
    for name in ("ground", "flags"):
        np.testing.assert_array_equal(getattr(one, name), getattr(replayed, name))
    # To rounding, which a processor's own code orders otherwise in a loop: after the lost
    # slots few rows tell the place, and some 1e-4 of the pitch (2e-6 m) comes of it.
    np.testing.assert_allclose(one.contacts.xy, replayed.contacts.xy, atol=2e-5)
    np.testing.assert_allclose(one.residual, replayed.residual, rtol=1e-2)
    # Sizes are of the order of 1 and hardly told: rounding moves them by some 1e-4.
    np.testing.assert_allclose(state.numbers, end.numbers, rtol=1e-2, atol=1e-3)
    np.testing.assert_array_equal(state.whole, end.whole)


@pytest.mark.long
def test_float32_beside_float64(step, scenes):
    wide = tx.make_step(tx.Sensor.grid(divisions=(32, 32)), "follow", "all")
    # As many slots as in the replay above, which is compiled.
    grounds = np.random.default_rng(4).integers(0, 64, 30)
    for name in ("one", "two"):
        volts = scenes[name][grounds]
        _, one = step.replay(step.state, volts, grounds)
        _, other = wide.replay(wide.state, volts, grounds)
        np.testing.assert_array_equal(one.contacts.count, other.contacts.count)
        # Sets of contacts that compete in the first slots end as near as they settle.
        for some, near in ((slice(8), 5e-4), (slice(8, None), 5e-5)):
            mine, wanted = one.contacts.xy[some], other.contacts.xy[some]
            np.testing.assert_allclose(mine, wanted, atol=near)


@pytest.mark.long
def test_hurried_slots_are_answered_by_the_cheaper_method(sensor, step, scenes):
    both = tx.make_step(sensor, "source", "all", cheaper="follow")
    volts, state, quick = scenes["one"], both.state, step.state
    for k in range(8):
        state, out = both(state, volts[k], k, hurried=k % 2 == 1)
        quick, want = step(quick, volts[k], k)
        assert bool(int(out.flags) & Flag.HURRIED) == (k % 2 == 1)
        if k % 2:
            np.testing.assert_allclose(out.contacts.xy, want.contacts.xy, atol=1e-5)
    assert both.traces == 1


def test_policies_ground_what_they_say(step, sensor, scenes):
    corners = np.asarray(tx.paper.exploration(sensor))
    volts = scenes["one"]
    state = step.switch(step.state, "around")
    _, outs = run(step, state, volts, 24)
    asked = [int(out.ground) for out in outs]
    around = np.asarray(tx.pattern(sensor, "around", volts[corners])).tolist()
    k = asked.index(int(corners[1])) + 1  # both corners are measured after this slot
    assert asked[k : k + 8] == around and asked[k + 8 : k + 10] == corners.tolist()
    # Of a contact in the middle of its region the same eight electrodes.
    _, outs = run(step, step.state, volts, 24)
    near = {int(out.ground) for out in outs[10:]}
    away = np.hypot(*(np.asarray(sensor.electrode_xy)[list(near)] - PLACE).T)
    assert len(near) == 8 and away.max() < 0.04
    # Information is in grounds near the contact, not in the far corner.
    _, outs = run(step, step.switch(step.state, "information"), volts, 24)
    xy = np.asarray(sensor.electrode_xy)[[int(out.ground) for out in outs[4:]]]
    assert np.hypot(*(xy - PLACE).T).max() < 0.05


def test_grounds_of_ones_own():
    """One policy, beside others by name or alone."""
    small = tx.Sensor.grid(4, 4, divisions=(16, 16))
    volts = np.asarray(tx.voltages(small, tx.Disc([0.03, 0.05], 0.006, 1.0)))
    several = ["all", [0, 7, 14], np.array([3]), jnp.array([4, 5]), "6,7"]
    step = tx.make_step(small, "source", several, contacts=1, grid=8)
    assert step.policies == ("all", "0,7,14", "3", "4,5", "6,7")
    _, outs = run(step, step.switch(step.state, "0,7,14"), volts, 12)
    asked = [int(out.ground) for out in outs[-6:]]
    assert sorted(asked) == [0, 0, 7, 7, 14, 14]
    assert asked[1:] + asked[:1] == [{0: 7, 7: 14, 14: 0}[g] for g in asked]
    alone = tx.make_step(small, "source", np.array([0, 7]), contacts=1, grid=8)
    assert alone.policies == ("0,7",)


@pytest.mark.parametrize(
    "wrong", ["0,16", [0, -1], "0,,1", "-", [0.5, 1.0], [[]], [0, "all"], [True, False]]
)
def test_what_is_no_policy(wrong):
    small = tx.Sensor.grid(4, 4, divisions=(16, 16))
    with pytest.raises(ValueError, match="policy: got"):
        tx.make_step(small, "source", wrong, contacts=1, grid=8)


@pytest.mark.long
def test_a_table_of_ones_own(sensor, scenes):
    """Four ground conditions by the half of the sheet."""
    table = np.zeros((2, 1, 4), int)
    table[0], table[1] = [0, 1, 2, 3], [60, 61, 62, 63]
    lookup = tx.step.Lookup(
        jnp.asarray(table), jnp.array([0, 63, 0, 63]), jnp.asarray(sensor.size)
    )
    step = tx.make_step(sensor, "follow", "mine", tables={"mine": lookup})
    state, outs = run(step, step.state, scenes["one"], 12)
    assert {int(out.ground) for out in outs[4:]} == {0, 1, 2, 3}
    _, outs = run(step, state, scenes["there"], 12)
    assert {int(out.ground) for out in outs[6:]} == {60, 61, 62, 63}


def test_unrolled_elimination(rng):
    a = rng.normal(size=(3, 7, 7))
    a, b = a @ a.transpose(0, 2, 1) + np.eye(7), rng.normal(size=(3, 7, 2))
    from tomojax.kernels.contacts import solve_small

    got = solve_small(jnp.asarray(a), jnp.asarray(b))
    np.testing.assert_allclose(got, np.linalg.solve(a, b), rtol=1e-9, atol=1e-9)


@pytest.mark.long
def test_tangents_are_the_field_and_its_slopes(step, sensor):
    from tomojax.kernels.contacts import radius_of, tangents

    sheet = tx.method(tx.Sensor.grid(divisions=(32, 32)), "points").sheet
    place, size = jnp.array([0.0431, 0.1187]), jnp.array(0.4)

    def at(p):
        moved = place + p[:2] * sheet.unit
        return field_at(sheet.field, moved, radius_of(sheet, size + p[2]))

    got = tangents(sheet, place, size)
    zero = jnp.zeros(3)
    np.testing.assert_allclose(got[0], at(zero), rtol=1e-9)
    np.testing.assert_allclose(got[1:].T, jax.jacfwd(at)(zero), rtol=1e-6, atol=1e-6)


def test_bad_arguments(step, sensor):
    volts = np.zeros(64)
    for call in (
        lambda: tx.make_step(sensor, "magic"),
        lambda: tx.make_step(sensor, policy="magic"),
        lambda: tx.make_step(sensor, policy=[]),
        lambda: tx.make_step(sensor, contacts=0),
        lambda: tx.make_step(sensor, good=np.ones(3)),
        lambda: tx.make_step(sensor, good=np.zeros(64)),
        lambda: tx.make_step(sensor, highest=-1.0),
        lambda: step(step.state, volts[:63], 0),
        lambda: step.replay(step.state, volts, [0]),
        lambda: step.replay(step.state, volts[None], [0, 1]),
        lambda: step.switch(step.state, "magic"),
    ):
        with pytest.raises(ValueError, match="got"):
            call()
