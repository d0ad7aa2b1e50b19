"""What becomes of slots on a wire that loses, repeats, breaks and cuts: without a clock."""

import time
from collections.abc import Sequence

import numpy as np
import pytest

from tomojax.hardware import sources as frames
from tomojax.hardware.sources import Link, WireSource

M = 8


class Script(Link):
    """A link that gives what a test lays out: lists of messages, or errors to raise."""

    def __init__(self, steps: Sequence):
        self.steps, self.sent, self.opened = list(steps), [], 0

    def open(self):
        self.opened += 1

    def receive(self, timeout):
        if not self.steps:
            raise EOFError("the test's end")
        step = self.steps.pop(0)
        if isinstance(step, Exception):
            raise step
        return step, time.perf_counter()

    def send(self, message):
        self.sent.append(frames.unpack_command(message, M))

    def close(self):
        pass


def told(sequence=0, session=1, electrodes=M):
    numbers = session, sequence, 1e4, 1e-4, 0.0
    return frames.pack_description(frames.Description(electrodes, *numbers))


def slot(sequence, ground=0, clock=None):
    time = 100 * sequence if clock is None else clock
    return frames.pack_slot(ground, sequence, time, np.full(M, sequence % 1000, "i2"))


def read(steps):
    """Everything that a source makes of them."""
    source, codes, found = WireSource(Script(steps), M), np.zeros(M, np.int16), []
    source.start()
    while True:
        try:
            got = source.read(codes, 0.3)
        except EOFError:
            return source, found
        if got is not None:
            found.append((int(codes[0]), got))


def accounted(source, found):
    """Every number is a slot or a lost one."""
    count = source.counters
    assert found[-1][1].number + 1 == count.slots + count.lost
    assert sum(got.lost for _, got in found) == count.lost


def test_gaps_are_numbers():
    source, found = read([[told(5)], [slot(5), slot(6), slot(9)], [slot(10), slot(14)]])
    assert [(code, got.lost, got.number) for code, got in found] == [
        (5, 0, 0),
        (6, 0, 1),
        (9, 2, 4),
        (10, 0, 5),
        (14, 3, 9),
    ]
    np.testing.assert_allclose([g.time for _, g in found], [0, 1e-4, 4e-4, 5e-4, 9e-4])
    accounted(source, found)


def test_late_repeated_broken_and_early_ones_are_not_given_out():
    bad = slot(2)[:-1] + b"\0"
    steps = [[slot(0)], [told(1)], [slot(1), slot(3), slot(2), slot(3), bad, slot(4)]]
    source, found = read(steps)
    assert [code for code, _ in found] == [1, 3, 4]
    count = source.counters
    assert (count.early, count.late, count.bad, count.lost) == (1, 2, 1, 1)
    accounted(source, found)


def test_numbers_go_round():
    last = 2**32 - 1
    source, found = read([[told(last)], [slot(last, clock=1), slot(0, clock=101), slot(2)]])
    assert [got.number for _, got in found] == [0, 1, 3]


def test_a_cut_line_is_opened_again_and_told_what_to_ground():
    steps = [[told()], [slot(0), slot(1)], OSError("cut"), [told(7)], [slot(7), slot(8)]]
    link = Script(steps)
    source, codes = WireSource(link, M), np.zeros(M, np.int16)
    source.start()
    source.set_grounds([3, 4])
    found = []
    while len(found) < 4:
        got = source.read(codes, 0.1)
        found += [got] if got else []
    assert [got.number for got in found] == [0, 1, 7, 8] and found[2].lost == 5
    assert source.counters.disconnects == 1 and link.opened == 2
    assert link.sent[-2:] == [(frames.START, ()), (frames.GROUNDS, (3, 4))]


def test_a_line_that_is_cut_as_soon_as_it_is_open():
    steps = [[told()], [slot(0)], OSError("cut"), [slot(4), slot(5)]]
    link = Script(steps)
    source, codes = WireSource(link, M), np.zeros(M, np.int16)
    source.start()
    send, tries = link.send, iter([True, True, False])

    def refused(message):
        if next(tries, False):
            raise ConnectionRefusedError
        send(message)

    found = []
    assert source.read(codes).number == 0
    link.send = refused
    while len(found) < 2:
        got = source.read(codes, 0.1)
        found += [got] if got else []
    assert [got.number for got in found] == [4, 5]
    assert source.counters.disconnects == 1


def test_a_line_without_room_is_not_cut():
    steps = [[told()], [slot(0)], [slot(1)]]
    link = Script(steps)
    source, codes = WireSource(link, M), np.zeros(M, np.int16)
    source.start()
    assert source.read(codes).number == 0

    def full(message):
        raise BlockingIOError

    link.send = full
    source.set_grounds([3])
    assert source.read(codes).number == 1
    assert link.opened == 1 and source.counters.disconnects == 0


@pytest.mark.parametrize("numbers", [(0.0, 1e-4), (1e4, 0.0), (np.nan, 1e-4)])
def test_a_rig_that_says_nothing_sound_of_itself(numbers):
    rate, scale = numbers
    bad = frames.pack_description(frames.Description(M, 1, 0, rate, scale, 0.0))
    with pytest.raises(ValueError, match="rate, scale, offset: got a rig with"):
        WireSource(Script([[bad]]), M).start()


def test_a_rig_that_comes_back_as_another_one():
    other = frames.pack_description(frames.Description(M, 2, 0, 1e4, 2e-4, 0.0))
    steps = [[told()], [slot(0)], [other], [slot(0)]]
    source, codes = WireSource(Script(steps), M), np.zeros(M, np.int16)
    source.start()
    assert source.read(codes).number == 0
    with pytest.raises(ValueError, match="rate, scale, offset: got a rig with"):
        source.read(codes)


def test_a_rig_that_was_switched_off_goes_on_in_time():
    steps = [[told()], [slot(0), slot(1)], OSError("cut"), [told(0, 2)], [slot(0), slot(1)]]
    source, found = read(steps)
    assert source.counters.restarts == 1
    gots = [got for _, got in found]
    assert gots[2].lost >= 1 and gots[3].number == gots[2].number + 1
    times = np.diff([got.time for got in gots])
    assert (times > 0).all()
    np.testing.assert_allclose(times[1], (gots[2].lost + 1) / 1e4)
    accounted(source, found)


def test_a_table_goes_row_by_row_and_again_after_a_restart():
    rows = frames.rows_of(np.eye(M)[:3], M)

    def answer(held, session=1, table=rows[0].table):
        numbers = session, 0, 1e4, 1e-4, 0.0, table, held
        return frames.pack_description(frames.Description(M, *numbers))

    # A description of another table is bad, a slot before the whole table early.
    steps = [[answer(3, table=7)], [slot(9)], [answer(1)], [answer(2)], [answer(2)]]
    steps += [[answer(3)], [slot(0, 2)], [slot(1, 3)], OSError("cut")]
    steps += [[answer(0, 2)], [answer(3, 2)], [slot(0, 1)]]
    link, sent, codes = Script(steps), [], np.zeros(M, np.int16)
    link.send = sent.append
    source = WireSource(link, M, np.eye(M)[:3])
    with pytest.raises(ValueError, match="grounds: got .*0 to 2"):
        source.set_grounds([3])
    source.start()
    assert [source.read(codes).ground] == [2]
    again = None
    while again is None:  # ground 3 is no row: bad
        again = source.read(codes, 0.3)
    assert again.ground == 1 and again.lost
    told = [frames.unpack_row(message, M).row for message in sent]
    assert told == [0, 1, 2, 2, 0]
    count = source.counters
    assert (count.bad, count.early, count.restarts) == (2, 1, 1)


def test_another_rig_is_an_error():
    with pytest.raises(ValueError, match="electrodes: got a rig with 16, expected 8"):
        read([[told(electrodes=16)]])


def test_a_ground_that_is_not_heeded_is_asked_for_again():
    steps = [[told()], *[[slot(k)] for k in range(120)]]
    link = Script(steps)
    source, codes = WireSource(link, M), np.zeros(M, np.int16)
    source.start()
    source.set_grounds([5])
    for _ in range(120):
        assert source.read(codes).ground == 0  # what it was, not what was asked for
    assert link.sent.count((frames.GROUNDS, (5,))) == 3
