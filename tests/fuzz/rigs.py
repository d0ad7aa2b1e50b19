"""Rigs that misbehave, as data: what each one sends, and what of it is sound.

    python tests/fuzz/rigs.py [SEEDS]

Each rig's messages go through the real source, ring and recorder of this checkout; then
the file is read and held against what was sent. `tests/hardware/test_rigs_fuzz.py` runs
each once.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from cobs import cobs

import tomojax as tx
from tomojax.hardware import run, SlotRing, sources as frames
from tomojax.hardware.loop.recorder import write
from tomojax.hardware.sources import Link, WireSource
from tomojax.hardware.sources.serial import Frames
from tomojax.recordings import attributes

M, RATE, N = 16, 10_000, 1200
START = frames.pack_command(frames.START)


def told(sequence: int = 0, session: int = 1, rate: float = RATE) -> bytes:
    numbers = session, sequence, rate, 1e-4, 0.0
    return frames.pack_description(frames.Description(M, *numbers))


@dataclass
class Rig:
    """What it sent that was sound and new; `started` tells it of a START."""

    rng: np.random.Generator
    sent: list[int] = field(default_factory=list)
    starts: int = 0

    def slot(self, sequence: int, clock: float, sound: bool = True) -> bytes:
        """A slot that is known again by its first two codes."""
        name = len(self.sent)
        codes = self.rng.integers(-100, 100, M).astype("i2")
        codes[:2] = name % 30_000, name // 30_000
        if sound:
            self.sent.append(name)
        else:
            codes[:2] = -1
        return frames.pack_slot(0, sequence % 2**32, int(clock) % 2**64, codes)

    def slots(self, count: int, sequence=lambda k: k, clock=lambda k: 100 * k, first=0):
        """Batches of a few slots; `first` of those numbers."""
        batch = []
        for k in range(first, first + count):
            batch.append(self.slot(sequence(k), clock(k)))
            if len(batch) == 7:
                yield batch
                batch = []
        yield batch

    def silent(self, junk: Callable[[], list[bytes]]) -> Iterator[list[bytes]]:
        """Nothing but junk until it is asked to start again."""
        before, end = self.starts, time.monotonic() + 5
        while self.starts == before and time.monotonic() < end:
            time.sleep(0.01)
            yield junk()


def serial(messages: list[bytes]) -> bytes:
    return b"".join(cobs.encode(message) + b"\0" for message in messages)


class Wire(Link):
    """From a rig's batches: lists of datagrams, or bytes of a serial line."""

    def __init__(self, rig: Rig, batches: Iterator):
        self._rig, self._batches = rig, batches
        self._frames = Frames(frames.slot_size(M))

    def open(self):
        pass

    def receive(self, timeout):
        try:
            batch = next(self._batches)
        except StopIteration:
            raise EOFError("the rig is switched off") from None
        found = self._frames(batch) if isinstance(batch, bytes) else batch
        return found, time.perf_counter()

    def send(self, message):
        self._rig.starts += message == START

    def close(self):
        pass


# Clocks, as functions of the slot's number, in µs.
CLOCKS = {
    "clock falls": lambda k: 10**6 + 100 * k - 5000 * (k >= 500),
    "clock falls often": lambda k: 10**6 + 100 * k - 150 * (k // 10),
    "clock wraps": lambda k: (2**32 - 50_000 + 100 * k) % 2**32,
    "clock wraps 64 bits": lambda k: (2**64 - 50_000 + 100 * k) % 2**64,
    "clock of 1 ms": lambda k: 100 * k // 1000 * 1000,
    "clock of 1 s": lambda k: 100 * k // 10**6 * 10**6,
    "clock stands": lambda k: 5,
    "clock drifts": lambda k: int(100 * k * 1.02),
    "clock to 1970": lambda k: 100 * k + (k < 400) * 1_700_000_000_000_000,
    "clock from 1970": lambda k: 100 * k + (k >= 400) * 1_700_000_000_000_000,
    "clock jumps and returns": lambda k: 100 * k + 10**7 * (400 <= k < 420),
    "clock in bursts": lambda k: 100 * (k // 40 + 1) * 40 + 30 * (k % 40),
    "clock backwards": lambda k: 10**9 - 100 * k,
    "clock random": lambda k: int(np.random.default_rng(k).integers(2**63)),
    "clock at twice the rate": lambda k: 200 * k,
    "clock at half the rate": lambda k: 50 * k,
    "clock changes its rate": lambda k: 100 * k + 100 * max(0, k - 600),
    "clock in ms": lambda k: k // 10,
    "clock in ns": lambda k: 100_000 * k,
}


def _jump(by: int, at: int = 500) -> Callable[[int], int]:
    return lambda k: k + by * (k >= at)


def _once(by: int, at: int = 500) -> Callable[[int], int]:
    return lambda k: k + by * (k == at)


# Counters of slots, as functions of the slot's number.
COUNTERS = {
    "counter jumps by 1": _jump(1),
    "counter jumps by 1000": _jump(1000),
    "counter jumps by 2^30": _jump(2**30),
    "counter jumps by 2^31": _jump(2**31),
    "counter falls by 5": _jump(-5),
    "counter falls by 400": _jump(-400),
    "counter begins anew": lambda k: k % 300,
    "counter wraps": lambda k: (2**32 - 500 + k) % 2**32,
    "one number 2^30 too high": _once(2**30),
    "one number 2^31 too high": _once(2**31),
    "one number 1000 too high": _once(1000),
    "one number 100 too low": _once(-100),
    "counter jumps at the start": _jump(2**30, 0),
}


def clocked(clock):
    def rig(rig: Rig) -> Iterator:
        yield [told()]
        yield from rig.slots(N, clock=clock)

    return rig


def counted(sequence):
    def rig(rig: Rig) -> Iterator:
        yield [told(sequence(0) if sequence(0) < 2**32 - 1 and sequence(0) != 2**30 else 0)]
        yield from rig.slots(N, sequence=sequence)

    return rig


def duplicates(rig: Rig) -> Iterator:
    yield [told()]
    for batch in rig.slots(N):
        yield batch + batch[-3:] if rig.rng.random() < 0.3 else batch


def everything_twice(rig: Rig) -> Iterator:
    yield [told()]
    for batch in rig.slots(N):
        yield [message for message in batch for _ in range(2)]


def reorders(rig: Rig) -> Iterator:
    """Slots change places with neighbours: those that come late are told so."""
    yield [told()]
    for batch in rig.slots(N):
        yield list(rig.rng.permutation(np.array(batch, object)))


def old_slots_again(rig: Rig) -> Iterator:
    yield [told()]
    old = list(rig.slots(N // 2))
    yield from old
    yield from old[20:50]
    yield from rig.slots(N // 2, first=N // 2)


def _junk(rig: Rig) -> list[bytes]:
    some = [rig.rng.bytes(int(n)) for n in rig.rng.integers(0, 90, 20)]
    whole = frames.pack_slot(0, 1, 1, np.zeros(M, "i2"))
    return [*some, whole[:-1], whole[:-1] + b"\0", whole + b"\0", b"", START]


def floods_of_junk(rig: Rig) -> Iterator:
    yield [told()]
    for batch in rig.slots(N):
        yield _junk(rig) + batch + _junk(rig)


def another_rig(rig: Rig) -> Iterator:
    """Valid slots of a second rig between its own: of another count and clock."""
    yield [told()]
    for j, batch in enumerate(rig.slots(N)):
        other = [
            rig.slot(10**6 + 9 * j + i, 10**12 + 900 * j + 100 * i, False) for i in range(5)
        ]
        yield [batch[0], *other, *batch[1:]] if batch else []


def another_rig_describes(rig: Rig) -> Iterator:
    """Descriptions of a second session that nobody asked for."""
    yield [told()]
    yield from rig.slots(N // 2)
    time.sleep(0.01)
    yield [told(0, 1)] * 5
    yield from rig.slots(N // 2, first=N // 2)


def restarts(times: int, noise: bool):
    def rig(rig: Rig) -> Iterator:
        for session in range(1, times + 2):
            if session > 1:
                junk = (lambda: _junk(rig)) if noise else list
                yield from rig.silent(junk)
            yield [told(0, session)]
            yield from rig.slots(N // (times + 1), clock=lambda k: 100 * k + 3)

    return rig


def restarts_and_sends(rig: Rig) -> Iterator:
    """Numbers and clock begin anew, and nobody is told of another session."""
    yield [told()]
    yield from rig.slots(N // 2)
    yield from rig.slots(N // 2)


def stops(rig: Rig) -> Iterator:
    yield [told()]
    yield from rig.slots(N // 2)
    for _ in range(3):
        yield []


def serial_junk(rig: Rig) -> Iterator:
    yield serial([told()])
    for batch in rig.slots(N):
        noise = rig.rng.bytes(int(rig.rng.integers(1, 200)))
        yield b"\0" + noise + b"\0" + serial(batch)


def cut_at_every_byte(rig: Rig) -> Iterator:
    """A frame ends early, at each of its bytes; the next is whole."""
    yield serial([told()])
    length = len(serial([frames.pack_slot(0, 0, 0, np.zeros(M, "i2"))]))
    for k in range(length - 1):
        whole = serial([rig.slot(2 * k, 200 * k)])
        yield whole[:3]
        yield whole[3:]
        yield serial([rig.slot(2 * k + 1, 200 * k + 100, False)])[:k] + b"\0"


def received_byte_by_byte(rig: Rig) -> Iterator:
    for message in ([told()], *rig.slots(60)):
        data = serial(message)
        for k in range(len(data)):
            yield data[k : k + 1]


def grounds_that_are_none(rig: Rig) -> Iterator:
    yield [told()]
    bad = frames.pack_slot(M + 3, 5, 5, np.zeros(M, "i2"))
    for batch in rig.slots(N):
        yield [bad, *batch]


# How many sound slots may be told late instead of given out; all others are in the file.
RIGS: dict[str, tuple[Callable[[Rig], Iterator], int]] = {
    **{name: (clocked(clock), 0) for name, clock in CLOCKS.items()},
    **{name: (counted(counter), 0) for name, counter in COUNTERS.items()},
    "duplicates": (duplicates, 0),
    "everything twice": (everything_twice, 0),
    "reorders": (reorders, N),
    "old slots again": (old_slots_again, 0),
    "floods of junk": (floods_of_junk, 0),
    "another rig's slots": (another_rig, 0),
    "another rig's words": (another_rig_describes, 0),
    "restarts once": (restarts(1, False), 0),
    "restarts once, noise": (restarts(1, True), 0),
    "restarts often, noise": (restarts(3, True), 0),
    "restarts and sends": (restarts_and_sends, 0),
    "stops": (stops, 0),
    "noise on a serial line": (serial_junk, 0),
    "cut at every byte": (cut_at_every_byte, 0),
    "byte by byte": (received_byte_by_byte, 0),
    "grounds that are none": (grounds_that_are_none, 0),
}


def check(name: str, folder: Path, seed: int = 0) -> str:
    """Plays a rig, records it, reads the file; fails where a slot is not accounted for."""
    play, late = RIGS[name]
    rig = Rig(np.random.default_rng(seed))
    source = WireSource(Wire(rig, play(rig)), M)
    ring = SlotRing.create(M, length=1 << 13, folder=folder)
    path = folder / f"{name.replace(' ', '-')}-{seed}.h5"
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    try:
        with source:
            run(source, None, ring)
        about = attributes(tx.recordings.Rig.of(sensor, float(RATE)), 1e-4, 0.0)
        ring.head["done"][...] = 1
        write(ring, path, about, 1e9)
    finally:
        ring.remove()
    return _judge(rig, source.counters, path, late)


def _judge(rig: Rig, count, path: Path, late: int) -> str:
    with tx.open_recording(path) as recording:
        scans = recording.read(0, recording.scans)
        lost = int(recording.gaps[:, 1].sum())
        mended = "; ".join(recording.mended)
        assert recording.rows_after_gaps().size == len(recording.gaps)
    codes = np.rint(scans.voltages[:, 0] / 1e-4).astype(int)
    names = codes[:, 0] + 30_000 * codes[:, 1]
    # Nothing let in, nothing twice, nothing lost, and in the order in which it was sent.
    assert (names >= 0).all() and (np.diff(names) > 0).all()
    missing = set(rig.sent) - set(names.tolist())
    assert len(missing) <= min(late, count.late), f"{len(missing)} of {len(rig.sent)}"
    assert len(names) == count.slots and lost == count.lost
    assert (np.diff(scans.t0) > 0).all()
    told = {k: n for k, n in count.as_dict().items() if n}
    return f"{told} {mended}"


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in RIGS:
            for seed in range(seeds):
                try:
                    said = check(name, Path(folder), seed)
                except Exception as error:
                    wrong += 1
                    said = f"WRONG {type(error).__name__}: {error}"
                if seed == 0 or said.startswith("WRONG"):
                    print(f"{name:28} {said}", flush=True)
    print(f"{len(RIGS)} rigs, {seeds} seeds, {wrong} wrong")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
