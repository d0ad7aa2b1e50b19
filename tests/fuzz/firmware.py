"""Holds the C firmware against the host's Python, on random and on broken frames.

    python tests/fuzz/firmware.py --frames 1000000   # byte-equal, with sanitizers
    python tests/fuzz/firmware.py --runs 1000000     # libFuzzer on the decoder (clang)

26 November 2026, gcc 12.2 and clang 14: see the lines that it prints.
"""

import argparse
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from cobs import cobs

from tomojax import hardware
from tomojax.hardware import sources as frames
from tomojax.hardware.sources.serial import Frames

FIRMWARE = Path(hardware.__file__).with_name("firmware")
PEER = Path(__file__).with_name("firmware_peer.c")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
EDGES = np.array([0, 1, -1, 255, 256, -256, 32767, -32768], "<i2")


def compiler() -> str | None:
    return shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")


def build(out: Path, *sources: Path, cc: str | None = None, flags=()) -> Path:
    """Compiles without a warning, or says what the compiler said."""
    command = [cc or compiler() or "cc", *STRICT, f"-I{FIRMWARE}", *flags, *sources]
    made = subprocess.run([*command, "-o", out], capture_output=True, text=True)
    if made.returncode:
        raise RuntimeError(made.stderr)
    return out


def build_peer(folder: Path) -> Path:
    return build(folder / "peer", PEER, FIRMWARE / "tomojax_rig.c", flags=SANITIZED)


def run(peer: Path, given: bytes, *arguments: str) -> bytes:
    done = subprocess.run([peer, *arguments], input=given, capture_output=True)
    if done.returncode:
        raise RuntimeError(done.stderr.decode(errors="replace"))
    return done.stdout


def random_frame(rng: np.random.Generator, m: int) -> tuple[bytes, bytes]:
    """A record for the peer, and what Python sends for it."""
    if rng.random() < 0.1:
        session, sequence = rng.integers(0, 2**32, 2).tolist()
        numbers = struct.unpack("<3d", rng.bytes(24))
        table, held = int(rng.integers(2**32)), int(rng.integers(257))
        has = bool(rng.random() < 0.5)
        told = frames.Description(
            m, session, sequence, *numbers, *((table, held) if has else ())
        )
        record = struct.pack("<BHIIdddHHI", 2, *told[:6], 1 + has, held, table)
        # Bits of a NaN are kept by `pack` only as far as the platform keeps them.
        if not all(np.isfinite(numbers)):
            return random_frame(rng, m)
        return record, cobs.encode(frames.pack_description(told)) + b"\0"
    codes = np.frombuffer(rng.bytes(2 * m), "<i2").copy()
    way = rng.random()
    if way < 0.3:
        codes[rng.random(m) < 0.5] = rng.choice(EDGES)
    elif way < 0.4:
        codes[:] = rng.choice(EDGES)
    ground = int(rng.integers(m))
    sequence = int(rng.choice([0, 2**32 - 1, rng.integers(2**32)]))
    clock = int.from_bytes(rng.bytes(8), "little") >> int(rng.integers(64))
    record = struct.pack("<BHBIQ", 1, m, ground, sequence, clock) + codes.tobytes()
    return record, cobs.encode(frames.pack_slot(ground, sequence, clock, codes)) + b"\0"


def compare_encoders(peer: Path, count: int, seed: int = 0) -> None:
    """Of every number of electrodes, one after another."""
    rng = np.random.default_rng(seed)
    for start in range(0, count, 20_000):
        some = range(start, min(start + 20_000, count))
        pairs = [random_frame(rng, k % 256 + 1) for k in some]
        ours = b"".join(coded for _, coded in pairs)
        theirs = run(peer, b"".join(record for record, _ in pairs), "encode")
        assert theirs == ours, f"frames {start} to {start + len(pairs)} differ, seed {seed}"


def random_row(rng: np.random.Generator, m: int) -> bytes:
    """A START with a row of a table, sound or not."""
    values = rng.uniform(0, 1, m).astype("<f4") * (rng.random(m) < 0.5)
    if rng.random() < 0.3:
        values[rng.integers(m)] = rng.choice([-1.0, -0.0, np.nan, np.inf, 1e-45])
    rows = int(rng.integers(0, 260))
    table, row = int(rng.integers(2**32)), int(rng.integers(rows + 1))
    return frames.pack_row(frames.Row(rows, table, row, values.astype("<f4")))


def accepted_by(message: bytes, m: int) -> bytes:
    """Returns the line that the peer writes for a message of the host."""
    command = frames.unpack_command(message, m)
    if command is not None:
        return bytes((command[0], len(command[1]), *command[1]))
    row = frames.unpack_row(message, m)
    if row is None:
        return b""
    packed = row.rows << 48 | row.row << 32 | row.table
    return struct.pack("<BBQ", frames.START, 0, packed) + row.conductances.tobytes()


def broken_stream(rng: np.random.Generator, m: int, count: int) -> bytes:
    """Commands among pieces of them, random bytes and zeros."""
    out = []
    for _ in range(count):
        grounds = rng.integers(0, m, rng.integers(1, min(m, 255) + 1)).tolist()
        kind = int(rng.choice([frames.START, frames.STOP, frames.GROUNDS]))
        sound = frames.pack_command(kind, grounds if kind == frames.GROUNDS else ())
        if rng.random() < 0.25:
            sound = random_row(rng, m)
        way = rng.integers(8)
        if way == 0:  # another number of electrodes, or kind, with a right sum
            body = bytearray(sound[:-4])
            body[rng.integers(len(body))] = rng.integers(256)
            sound = frames.sealed(bytes(body))
        coded = bytearray(cobs.encode(sound) + b"\0")
        if way == 1:
            coded[rng.integers(len(coded))] ^= 1 << int(rng.integers(8))
        elif way == 2:
            del coded[: rng.integers(len(coded))]
        elif way == 3:
            del coded[rng.integers(len(coded)) :]
        elif way == 4:
            coded += rng.bytes(int(rng.integers(700)))
        elif way == 5:
            coded += bytes(int(rng.integers(4)))
        elif way == 6:
            coded = bytearray(rng.bytes(int(rng.integers(40)))) + coded
        out.append(bytes(coded))
    return b"".join(out)


def compare_decoders(peer: Path, count: int, seed: int = 0, each: int = 200) -> int:
    """The same commands accepted; returns how many."""
    rng, accepted = np.random.default_rng(seed), 0
    for k in range(0, count, each):
        m = (1, 2, 10, 64, 245, 246, 254, 255, 256)[(k // each) % 9]
        stream = broken_stream(rng, m, each)
        found = [accepted_by(one, m) for one in Frames(16 + 4 * m)(stream)]
        theirs = run(peer, stream, "decode", str(m))[:-10]
        assert theirs == b"".join(found), f"M {m}, seed {seed}, stream {k}"
        accepted += sum(map(bool, found))
    return accepted


def fuzz(folder: Path, runs: int) -> str:
    """libFuzzer's last line; raises where it finds anything."""
    flags = ("-g", "-O1", "-DFUZZER", "-fsanitize=fuzzer,address,undefined")
    flags = (*flags, "-fno-sanitize-recover=all")
    sources = PEER, FIRMWARE / "tomojax_rig.c"
    target = build(folder / "target", *sources, cc="clang", flags=flags)
    corpus = folder / "corpus"
    corpus.mkdir()
    for m in (1, 64, 256):
        stream = broken_stream(np.random.default_rng(m), m, 4)
        (corpus / str(m)).write_bytes(bytes([m - 1]) + stream)
    command = [target, f"-runs={runs}", "-seed=1", "-max_len=1200", corpus]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-4000:])
    return done.stderr.strip().splitlines()[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=0, help="of the encoder")
    parser.add_argument("--commands", type=int, default=0, help="in mutated streams")
    parser.add_argument("--runs", type=int, default=0, help="of libFuzzer")
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        peer = build_peer(Path(name))
        if told.frames:
            compare_encoders(peer, told.frames, told.seed)
            print(f"{told.frames} frames: byte-equal, sanitizers clean", flush=True)
        if told.commands:
            some = compare_decoders(peer, told.commands, told.seed)
            print(f"{told.commands} commands and mutants: the same {some} accepted")
        if told.runs:
            print(f"libFuzzer: {fuzz(Path(name), told.runs)}")
    print(f"{time.perf_counter() - begun:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
