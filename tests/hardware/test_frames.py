"""Messages: the vectors of the page that firmware is written from, and broken ones."""

import re
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs

from tomojax import hardware
from tomojax.hardware import sources as frames
from tomojax.hardware.sources.serial import Frames

PAGE = Path(hardware.__file__).with_name("PROTOCOL.md")
CODES = np.array([0, -1, 1000, -32768], "i2")
TOLD = frames.Description(4, 0xA1B2C3D4, 7, 1e4, 2.0**-13, 0.0)


TABLE = [[0.25, 0, 0, 0.25], [0, 0.5, 0.125, 0]]
ROWS = frames.rows_of(np.array(TABLE), 4)


def vectors() -> list[tuple[bytes, bytes]]:
    """Message and what a serial line carries, in the page's order."""
    rows = re.findall(r"^    ((?:[0-9a-f]{2} ?)+)$", PAGE.read_text(), re.MULTILINE)
    found = [bytes.fromhex(row) for row in rows]
    return list(zip(found[::2], found[1::2]))


def test_vectors_of_the_page():
    pack = frames.pack_command
    ours = [
        pack(frames.START),
        pack(frames.STOP),
        pack(frames.GROUNDS, (0, 2, 3)),
        frames.pack_description(TOLD),
        frames.pack_row(ROWS[1]),
        frames.pack_description(TOLD._replace(table=ROWS[0].table, held=2)),
        frames.pack_slot(2, 300, 123_456_789, CODES),
    ]
    page = vectors()
    assert [message for message, _ in page] == ours
    assert [line for _, line in page] == [cobs.encode(m) + b"\0" for m in ours]
    commands = [frames.unpack_command(m, 4) for m in ours[:3]]
    assert commands == [
        (frames.START, ()),
        (frames.STOP, ()),
        (frames.GROUNDS, (0, 2, 3)),
    ]
    assert frames.unpack(ours[3], 4) == TOLD
    row = frames.unpack_row(ours[4], 4)
    assert row is not None and row[:3] == (2, 0x7E38813E, 1)
    np.testing.assert_array_equal(row.conductances, TABLE[1])
    assert frames.unpack(ours[5], 4) == TOLD._replace(table=0x7E38813E, held=2)
    slot = frames.unpack(ours[6], 4)
    assert isinstance(slot, frames.Slot)
    assert (slot.ground, slot.sequence, slot.microseconds) == (2, 300, 123_456_789)
    np.testing.assert_array_equal(slot.codes, CODES)


def broken(rng: np.random.Generator, sound: bytes, other: bytes) -> bytes:
    """One of the ways in which a line breaks a message."""
    bad = bytearray(sound)
    way = rng.integers(7)
    if way == 0:  # random bytes of the right length
        return rng.bytes(len(sound))
    if way == 1:  # bits
        for k in rng.integers(0, 8 * len(bad), rng.integers(1, 6)):
            bad[k // 8] ^= 1 << (k % 8)
    elif way == 2:  # a burst
        start = rng.integers(0, len(bad) - 20)
        bad[start : start + 20] = rng.bytes(20)
    elif way == 3:  # cut off
        return sound[: rng.integers(1, len(sound))]
    elif way == 4:  # the head of one and the tail of another
        at = rng.integers(1, len(sound))
        return sound[:at] + other[at:]
    elif way == 5:  # a byte more or less
        at = rng.integers(len(bad))
        bad = (
            bad[:at] + bad[at + 1 :] if rng.random() < 0.5 else bad[:at] + b"\5" + bad[at:]
        )
    else:  # right everywhere but in its codes
        bad[16:-4] = rng.bytes(len(bad) - 20)
    return bytes(bad)


def test_100_000_broken_messages_among_sound_ones():
    """On a serial line: none is taken for a slot, every sound one between them is."""
    rng = np.random.default_rng(2026)
    codes = rng.integers(-30000, 30000, (64, 64)).astype("i2")
    # The same slot's head in all: what is spliced differs in what it says alone.
    pool = [frames.pack_slot(k, 77, 10_000_000, row) for k, row in enumerate(codes)]
    line = Frames(frames.slot_size(64))
    taken, sound, stream = [], [], []
    for k in range(100_000):
        a, b = pool[k % 64], pool[rng.integers(64)]
        bad = broken(rng, a, b)
        if bad != a and bad != b:
            coded = cobs.encode(bad)
            if k % 5 == 0:  # broken as it is on the line, zeros and all
                coded = broken(rng, cobs.encode(a), cobs.encode(b))
                whole = cobs.encode(a), cobs.encode(b)
                coded = b"\7" if set(coded.split(b"\0")) & set(whole) else coded
            stream.append(coded + b"\0")
        if k % 10 == 0:
            stream.append(cobs.encode(a) + b"\0")
            sound.append(k % 64)
        if len(stream) > 500:
            data = b"".join(stream)
            cut = rng.integers(len(data))  # reads end anywhere
            for piece in (data[:cut], data[cut:]):
                found = (frames.unpack(m, 64) for m in line(piece))
                taken += [slot.ground for slot in found if slot is not None]
            stream = []
    found = (frames.unpack(m, 64) for m in line(b"".join(stream)))
    taken += [slot.ground for slot in found if slot is not None]
    assert taken == sound


def test_100_000_broken_datagrams():
    rng = np.random.default_rng(7)
    codes = rng.integers(-30000, 30000, (64, 64)).astype("i2")
    pool = [frames.pack_slot(k, 77, 10_000_000, row) for k, row in enumerate(codes)]
    for k in range(100_000):
        a, b = pool[k % 64], pool[(k + 1) % 64]
        bad = broken(rng, a, b)
        assert bad in (a, b) or frames.unpack(bad, 64) is None


def test_broken_commands_have_no_effect():
    rng = np.random.default_rng(5)
    pack = frames.pack_command
    pool = [
        pack(frames.GROUNDS, tuple(rng.integers(0, 64, n).tolist())) for n in range(1, 65)
    ]
    for k in range(20_000):
        sound = pool[k % 64]
        bad = bytearray(sound)
        bad[rng.integers(len(bad))] ^= int(rng.integers(1, 256))
        assert frames.unpack_command(bytes(bad), 64) is None
        assert frames.unpack_command(sound[: rng.integers(len(sound))], 64) is None
    beyond = frames.sealed(bytes((frames.GROUNDS, 1, 0, 0, 64)))
    assert frames.unpack_command(beyond, 64) is None


@pytest.mark.parametrize(
    "change",
    [
        {"conductances": [0, 0, 0, 0]},
        {"conductances": [0.1, -0.1, 0, 0]},
        {"conductances": [0.1, np.nan, 0, 0]},
        {"conductances": [0.1, np.inf, 0, 0]},
        {"conductances": [0.1, 0, 0]},
        {"rows": 0},
        {"rows": 257},
        {"row": 2},
    ],
)
def test_rows_of_a_table_that_have_no_effect(change):
    value = np.array(change.get("conductances", TABLE[1]))
    bad = ROWS[1]._replace(**(change | {"conductances": value}))
    assert frames.unpack_row(frames.pack_row(bad), 4) is None


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 4)), np.ones((2, 3)), np.ones(4), -np.ones((2, 4)),
              np.full((1, 4), np.nan), np.full((1, 4), 1e-60), np.ones((257, 4))],
)  # fmt: skip
def test_tables_that_are_none(wrong):
    with pytest.raises(ValueError, match="conditions.*: got .*, expected"):
        frames.rows_of(wrong, 4)


def test_memory_is_not_taken_by_what_has_no_end():
    line = Frames(frames.slot_size(64))
    for _ in range(1000):
        assert line(b"\x17" * 65536) == []
    assert len(line._rest) < 1000
    sound = frames.pack_slot(3, 1, 2, np.zeros(64, "i2"))
    told = line(b"\0" + cobs.encode(sound) + b"\0")
    assert told == [b"", sound]


@pytest.mark.parametrize("wrong", [(), (64,), (-1,), tuple(range(65))])
def test_grounds_that_there_are_not(wrong):
    with pytest.raises(ValueError, match="grounds"):
        frames.check_grounds(wrong, 64)


def test_description_as_long_as_a_slot():
    """Of ten electrodes: each is told by its kind."""
    told = frames.Description(10, 1, 2, 1e4, 1e-4, 0.0)
    assert frames.unpack(frames.pack_description(told), 10) == told
    slot = frames.unpack(frames.pack_slot(9, 5, 6, np.arange(10, dtype="i2")), 10)
    assert isinstance(slot, frames.Slot) and slot.ground == 9


def test_more_grounds_than_a_byte_counts():
    """Of 256 electrodes: refused by name, where the packer failed on the byte."""
    assert len(frames.check_grounds(range(255), 256)) == 255
    with pytest.raises(ValueError, match="grounds: got .*1 to 255"):
        frames.check_grounds(range(256), 256)


def test_nothing_between_two_zeros():
    """Is no message, and not counted; what cannot be decoded is."""
    sound = frames.pack_command(frames.START)
    line = Frames(frames.slot_size(64))
    assert line(b"\0\0" + cobs.encode(sound) + b"\0\0\0") == [sound]
    assert line(b"\1\0\5\1\0") == [b"", b""]
