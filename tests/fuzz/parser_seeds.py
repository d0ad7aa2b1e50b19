"""Good inputs of the parsers that `parsers.py` fuzzes, and mutations of them."""

import io
import json
from typing import Any

import numpy as np


def wire() -> list[bytes]:
    """A rig of four electrodes that describes itself, and slots; another START between."""
    from tomojax.hardware import sources as frames

    told = frames.Description(4, 7, 5, 1e4, 2.0**-13, 0.0)
    said = b"\0\6" + frames.pack_description(told)[:-4]
    codes = np.arange(4, dtype=np.int16)
    slots = [
        b"\1\5" + frames.pack_slot(k % 4, 5 + k, 100 * k, codes)[:-4] for k in range(6)
    ]
    again = b"\0\6" + frames.pack_description(told._replace(session=8))[:-4]
    return [b"\3" + said + b"".join(slots), b"\3" + said + slots[0] + again + slots[1]]


def messages() -> list[bytes]:
    return [b"\3" + each[k : k + 45] for each in wire() for k in (2, 44, 72)] + [
        b"\3\7\x12\3\0\0\0\2\3",
        b"\3\x0f\x10\2\2\0\1\2\3\4\1\0\0\0" + b"\0\0\x80\x3e" * 4,
    ]


def serial() -> list[bytes]:
    return [b"\x20\3\5\1\2\3\4\0\3\1\2\0\0", bytes(range(255, -1, -1)) * 2]


def calibration() -> list[bytes]:
    head: dict[str, Any] = {"schema": "tomojax-calibration", "schema_version": 1}
    rows = {"gain": [1, 1.1, 0.9], "offset": [0.01, 0, 0], "electrodes": [[0, 1e-3]] * 3}
    more = {"noise": 1e-3, "sheet": [0.01] * 14, "ground": 2.0, "error": 0.5, "own": 0.1}
    rest = {"pressure": [1e-4, 0.8], "made": "2026-01-31", "deviation": {"gain": [0.1] * 3}}
    return [json.dumps(head | each).encode() for each in ({}, rows, more, rest)]


def arrays(**arrays: Any) -> bytes:
    """Arrays as `packed` of `parser_targets.py` has them."""
    found, names = b"\1", ("table", "idle", "size", "lam", "xy")
    for name, values in arrays.items():
        array = io.BytesIO()
        np.save(array, values)
        content = array.getvalue()
        found += bytes([names.index(name)]) + len(content).to_bytes(2, "little") + content
    return found


def policy() -> list[bytes]:
    table, idle = np.array([[[0, 3]], [[12, 15]]]), np.array([0, 15])
    given = {"table": table, "idle": idle, "size": np.array([0.08, 0.08])}
    return [arrays(**given), arrays(**given, lam=np.ones((2, 1)))]


def places() -> list[bytes]:
    text = b"tx,y\n0.03,0.05\n0.04,0.04\n"
    return [text, b"t# x\n1e-2,nan\n", b"\0" + arrays(xy=np.full((3, 2), 0.05))]


TOML = b"""
pattern = "all"
seconds = 2.5
file-seconds = 60
view = "none"
channels = [1, 0, 2]
grounds = [0, -1]
baud = 9600
"""


def options() -> list[bytes]:
    lines = [b"v -o o.h5 --seconds 2 --channels 1,0", b"r.h5 --drift 0.1,0.2 --hold 3"]
    lines += [b"v --budget 1e-3 --contacts 2 --speed 1", b"r.h5 --grid 8 --lam 1e-3"]
    known = [line.replace(b" ", b"\0") for line in lines]
    return [bytes([number]) + line for number in range(12) for line in known]


# What makes another branch more often than bytes drawn at random.
_TOKENS = (b"nan", b"-inf", b"1e999", b"-1", b"0", b"[[", b"\xff" * 4, b"\0" * 4)
_TOKENS += (b"9" * 20, b"9" * 4400, b"1e-310", b"\xc2\xb2", b"true", b"null", b'"', b"{")


_VALUES = ("null", "true", "-1", "0", "1e-310", "1e300", "NaN", "Infinity", "1" + "0" * 400)
_VALUES += ('"x"', '""', '"1.5"', "[]", "{}", "[[1, 2]]", "[[], 1]", '{"a": [NaN]}')
_VALUES += (f"{[1.0] * 3}", f"{[0.1] * 14}", f"{[10] * 27}", f"{[0] * 14}", '["1", "2"]')


def mutated_json(text: bytes, rng: np.random.Generator) -> bytes | None:
    """Another value somewhere in a JSON text; None for what is none."""
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        return None

    def changed(node: Any, depth: int) -> Any:
        if not isinstance(node, (dict, list)) or not node or rng.random() < 0.1 * depth:
            return json.loads(_VALUES[rng.integers(len(_VALUES))])
        keys: list[Any] = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[rng.integers(len(keys))]
        if rng.random() < 0.1 and depth:
            del node[key]
        else:
            node[key] = changed(node[key], depth + 1)
        return node

    for _ in range(rng.integers(1, 4)):
        tree = changed(tree, 0)
    return json.dumps(tree).encode()


def mutated(seeds: list[bytes], rng: np.random.Generator) -> bytes:
    """A good input with some bytes changed, left out, doubled or taken from another."""
    data = bytearray(seeds[rng.integers(len(seeds))])
    tree = mutated_json(data, rng) if data[:1] == b"{" and rng.random() < 0.7 else None
    if tree is not None:
        return tree
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(data) + 1))
        some = int(rng.integers(1, 9))
        other = seeds[rng.integers(len(seeds))]
        start = int(rng.integers(len(other) + 1))
        data[at : at + int(rng.choice([0, some]))] = (
            rng.bytes(some),
            b"",
            other[start : start + some],
            data[at : at + some] * 2,
            _TOKENS[rng.integers(len(_TOKENS))],
        )[rng.integers(5)]
    return bytes(data)
