"""The firmware in C: its vectors, beside Python's frames, an example board on a line."""

import os
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

if sys.platform == "win32":
    pytest.skip("no pseudo-terminals", allow_module_level=True)

import tty

from firmware import (
    build,
    build_peer,
    compare_decoders,
    compare_encoders,
    compiler,
    FIRMWARE,
    fuzz,
    STRICT,
)

from tomojax.hardware.sources import open_source

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

RIG = FIRMWARE / "tomojax_rig.c"


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    try:
        return build_peer(tmp_path_factory.mktemp("peer"))
    except RuntimeError as error:
        if "san" in str(error):
            pytest.skip("no sanitizers beside the compiler")
        raise


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """2000 slots a second of 64 electrodes."""
    sources = FIRMWARE / "example_rig.c", RIG, FIRMWARE / "board_host.c"
    out = tmp_path_factory.mktemp("board") / "rig"
    return build(out, *sources, flags=("-O1", "-DSLOT_MICROSECONDS=500"))


def test_vectors_of_the_page_in_c(tmp_path):
    made = build(tmp_path / "vectors", FIRMWARE / "test_vectors.c", RIG)
    assert subprocess.run([made], capture_output=True, text=True).stdout == "ok\n"


def test_messages_need_no_library(tmp_path):
    """On a bare board, but for what its compiler itself may call."""
    command = [compiler() or "", *STRICT, "-Os", "-ffreestanding", "-c", RIG]
    subprocess.run([*command, "-o", tmp_path / "rig.o"], check=True)
    told = subprocess.run(["nm", "-u", tmp_path / "rig.o"], capture_output=True, text=True)
    wanted = set(told.stdout.split()) - {"U", "_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert wanted <= {"memcpy", "memset"}


def test_c_sends_what_python_sends(peer):
    compare_encoders(peer, 1024, seed=1)


def test_c_takes_what_python_takes(peer):
    assert compare_decoders(peer, 1800, seed=1) > 300


def test_decoder_is_fuzzed_for_a_moment(tmp_path):
    try:
        fuzz(tmp_path, 5000)
    except (FileNotFoundError, RuntimeError) as error:
        if isinstance(error, FileNotFoundError) or "fuzzer" in str(error):
            pytest.skip("no clang with libFuzzer")
        raise


@contextmanager
def switched_on(board, name):
    """The board at one end of a pseudo-terminal; the name leads to the other."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    name.unlink(missing_ok=True)
    name.symlink_to(os.ttyname(theirs))
    process = subprocess.Popen([board], stdin=ours)
    try:
        yield
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def read(source, count):
    """Slots as (ground, codes); None where one does not come."""
    codes, found = np.zeros(64, np.int16), []
    end = time.monotonic() + 60
    while len(found) < count and time.monotonic() < end:
        got = source.read(codes, 1.0)
        if got is not None:
            found.append((got.ground, codes.copy(), got))
    return found


def test_example_board_is_recorded(board, tmp_path):
    """Codes are those of the ground that was told; grounds are followed; none is lost.

    A slot that the busy computer's board could not measure in time has a number: what
    came and what was told lost are all of them.
    """
    name = tmp_path / "tty"
    with switched_on(board, name), open_source(f"serial:{name}") as source:
        assert (source.rate, source.scale, source.offset) == (2000.0, 2.0**-13, 0.0)
        first = read(source, 50)
        assert {ground for ground, _, _ in first} == {0}
        source.set_grounds((5, 63, 7))
        found = read(source, 400)
    told = [got for _, _, got in first + found]
    for ground, codes, _ in first + found:
        np.testing.assert_array_equal(codes, 100 * ground + np.arange(64) - 9000)
    assert source.counters.bad == source.counters.late == source.counters.jumps == 0
    assert (
        told[-1].number + 1
        == source.counters.slots + source.counters.lost
        == (len(told) + sum(got.lost for got in told))
    )
    after = {5: 63, 63: 7, 7: 5}
    pairs = [(a[0], b[0]) for a, b in zip(found, found[1:]) if not b[2].lost and a[0]]
    assert len(pairs) > 300
    assert all(after[before] == ground for before, ground in pairs)
    assert np.diff([got.time for got in told]).min() > 0


def test_example_board_takes_a_table(board, tmp_path):
    """Each slot has the row's grounds; without a table the board is as before."""
    name = tmp_path / "tty"
    table = np.zeros((3, 64))
    table[[0, 0, 1, 1, 2], [1, 4, 2, 20, 63]] = 0.25
    with switched_on(board, name):
        with open_source(f"serial:{name}", conditions=table) as source:
            assert source.condition_count == 3
            source.set_grounds((0, 1, 2))
            for ground, codes, _ in read(source, 100):
                first = 100 * np.flatnonzero(table[ground]).sum() - 9000
                np.testing.assert_array_equal(codes, first + np.arange(64))
            assert source.counters.bad == 0
        with open_source(f"serial:{name}", conditions=2 * table[:2]) as source:
            assert {ground for ground, _, _ in read(source, 20)} == {0}
        with open_source(f"serial:{name}") as source:
            source.set_grounds((9,))
            ground, codes, _ = read(source, 50)[-1]
            assert ground == 9 and codes[0] == 900 - 9000


def test_a_table_that_the_board_has_no_room_for(board, tmp_path):
    name = tmp_path / "tty"
    with switched_on(board, name):
        source = open_source(f"serial:{name}", conditions=np.eye(64)[np.arange(70) % 64])
        with pytest.raises(TimeoutError, match="the rig took 64 of 70 ground conditions"):
            source.start()


def test_example_board_plugged_out_and_in(board, tmp_path):
    """A restart is a new session, silent until START; the host goes on by itself."""
    name = tmp_path / "tty"
    with switched_on(board, name):
        source = open_source(f"serial:{name}")
        source.start()
        source.set_grounds((9,))
        assert len(read(source, 100)) == 100
    with switched_on(board, name):
        found = read(source, 200)
        source.stop()
    assert len(found) == 200
    assert source.counters.restarts == source.counters.disconnects == 1
    assert [ground for ground, _, _ in found][-100:] == [9] * 100
    assert sum(got.lost for _, _, got in found) > 0


def test_example_board_is_silent_until_start(board, tmp_path):
    name = tmp_path / "tty"
    with switched_on(board, name):
        line = os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        time.sleep(0.2)
        with pytest.raises(BlockingIOError):
            os.read(line, 100)
        os.close(line)
