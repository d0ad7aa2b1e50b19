"""Writes a step as C, compiles it, and runs it from Python."""

import hashlib
import zlib
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tomojax._require import require
from tomojax.native import c_type, function, PRELUDE, program_of, Tables
from tomojax.step._packing import Packed
from tomojax.step._traced import Traced

# The files of the step's face in C.
TEMPLATES = Path(__file__).parent

# Operations of a step that a compiler is asked to take: `follow` has 2200, which take it a
# quarter of a minute.
_MOST = 10_000

# A file of tables begins with a line of 64 bytes: what it is, the code that it belongs to
# (32 letters from the 16th byte), and from the 48th byte on a checksum of what follows.
_MAGIC = b"TOMOJAX STEP 1\n"
_HEAD = 64


class Code(NamedTuple):
    """A step in C: the source and its header belong to a shape, the tables to one rig."""

    source: str
    header: str
    tables: bytes
    name: str  # of the code: a digest
    told: dict[str, Any]  # facts that files of a folder are filled with


def write_code(traced: Traced, halved: bool = False) -> Code:
    """Writes a step as C99; `halved`: with its largest tables in 16 bits.

    **Raises:** `ValueError` for an operation that has no C.
    """
    tables = Tables(halved)
    numbers, whole = (np.asarray(a) for a in traced.state)
    volts, slot = traced.slot

    def step(numbers: Any, whole: Any, volts: Any, slot: Any) -> tuple:
        state, said = traced.run(Packed(numbers, whole), volts, slot)
        return *state, *said

    def image(numbers: Any, whole: Any) -> tuple:
        return (traced.draw(Packed(numbers, whole)),)

    stepped = program_of(step, numbers, whole, volts, slot)
    count = stepped.count
    require(count <= _MOST, "step", f"{count} operations", f"at most {_MOST}, to be C")
    drawn = program_of(image, numbers, whole)
    parts = [function("run_step", stepped, tables), function("run_image", drawn, tables)]
    first = [tables.add(a) for a in (numbers, whole)]
    about = traced.about
    nx, ny = drawn.outputs[0].shape
    told = {
        "METHOD": about.method,
        "ELECTRODES": about.electrode_count,
        "CONDITIONS": about.condition_count,
        "CONTACTS": about.contact_count,
        "POLICIES": ", ".join(about.policies),
        "POLICY_COUNT": len(about.policies),
        "T": c_type(traced.dtype),
        "NUMBERS": len(numbers),
        "WHOLE": len(whole),
        "NX": nx,
        "NY": ny,
        "BYTES": tables.size,
        "FIRST_NUMBERS": first[0],
        "FIRST_WHOLE": first[1],
        "POLICY_AT": about.policy_at,
        "LENGTH_AT": about.length_at,
        "GROUND_AT": about.ground_at,
        "SAID_NUMBERS": stepped.outputs[2].size,
        "SAID_WHOLE": stepped.outputs[3].size,
        "VERSION": version("tomojax"),
    }
    text = "\n".join(parts)
    digest = hashlib.sha256((PRELUDE + text + repr(sorted(told.items()))).encode())
    name = told["CODE"] = digest.hexdigest()[:32]
    face, header = (filled(file, told) for file in ("step.c", "tomojax_step.h"))
    return Code(
        PRELUDE + text + face, header, _with_head(tables.packed(), name), name, told
    )


def filled(file: str, told: dict[str, Any]) -> str:
    """Fills in what stands between two @."""
    text = (TEMPLATES / file).read_text()
    for name, value in told.items():
        text = text.replace(f"@{name}@", str(value))
    return text


def _with_head(tables: bytes, name: str) -> bytes:
    head = bytearray(_HEAD)
    head[: len(_MAGIC)] = _MAGIC
    head[16:48] = name.encode()
    head[48:52] = zlib.crc32(tables).to_bytes(4, "little")
    return bytes(head) + tables


def check_tables(bytes_: Any, name: str) -> None:
    """Checks a file of tables, as the C does. **Raises:** `ValueError` for a wrong one."""
    head = bytes(bytes_[:_HEAD])
    require(head.startswith(_MAGIC), "tables", "another kind of file", "tables of a step")
    require(head[16:48] == name.encode(), "tables", "those of another code", name)
    told = int.from_bytes(head[48:52], "little")
    same = zlib.crc32(memoryview(bytes_)[_HEAD:]) == told
    require(same, "tables", "bytes that have changed", "those of their checksum")
