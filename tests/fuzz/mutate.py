"""Mutations of files: bits and stretches of any, and what a format's structure allows."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

# What the canary, another file of the machine, consists of: electrodes' numbers that no
# seed has, so that they are seen where they are printed or written.
CANARY = bytes((37, 41, 43, 47))

_WORDS = [0, 1, 2, 7, 63, 64, 127, 128, 255, 2**15, 2**16, 2**24, 2**28, 2**31, 2**32 - 1]
_WIDE = [2**40, 2**48, 2**63 - 1, 2**63, 2**64 - 1]
_NUMBERS = [0.0, -1.0, 1e-300, 1e300, np.nan, np.inf, -np.inf, 1e-5, 1e5, 2.0**53]

Rng = np.random.Generator


def one(rng: Rng, some: Any) -> Any:
    return some[int(rng.integers(len(some)))]


def bytes_of(content: bytes, rng: Rng) -> bytes:
    """Bits, words, stretches, cuts and repeats; half of them where headers lie."""
    made = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        if not made:
            break
        # Headers and indices are small beside the data.
        near = min(len(made), 4096) if rng.random() < 0.5 else len(made)
        at, kind = int(rng.integers(near)), int(rng.integers(8))
        length = int(min(2 ** rng.integers(0, 12), len(made) - at))
        if kind <= 1:
            made[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            word = int(one(rng, _WORDS)).to_bytes(4, "little")
            made[at : at + 4] = word[: len(made) - at]
        elif kind == 3:
            word = int(one(rng, _WORDS + _WIDE)).to_bytes(8, "little")
            made[at : at + 8] = word[: len(made) - at]
        elif kind == 4:
            made[at : at + length] = one(rng, (b"\0", b"\xff", CANARY[:1])) * length
        elif kind == 5:
            made[at : at + length] = rng.bytes(length)
        elif kind == 6:
            source = int(rng.integers(len(made)))
            piece = made[source : source + length]
            made[at : at + len(piece)] = piece
        elif rng.random() < 0.3:
            del made[at:]
        else:
            del made[at : at + length]
    return bytes(made)


def hdf5(content: bytes, rng: Rng, canary: Path) -> bytes:
    """One or two members or attributes replaced by others; then, at times, bytes too."""
    raw = io.BytesIO(content)
    try:
        with h5py.File(raw, "r+") as file:
            for _ in range(int(rng.integers(1, 3))):
                _change(file, rng, canary)
    except Exception:  # a change that HDF5 does not let be made
        return bytes_of(content, rng)
    made = raw.getvalue()
    return bytes_of(made, rng) if rng.random() < 0.2 else made


def _change(file: h5py.File, rng: Rng, canary: Path) -> None:
    names = [n for n in file if isinstance(file.get(n), h5py.Dataset)]
    if rng.random() < 0.35 or not names:
        holder: Any = file if rng.random() < 0.8 or not names else file[one(rng, names)]
        told = list(holder.attrs) or ["schema"]
        name = one(rng, told)
        if rng.random() < 0.15:
            del holder.attrs[name]
        else:
            holder.attrs[name] = _value(rng)
        return
    name = one(rng, names)
    old: Any = file[name]
    shape, kind, chunks = old.shape, old.dtype, old.chunks
    values = old[()] if old.size < 1 << 20 else None
    marks = dict(old.attrs)
    del file[name]
    choice = int(rng.integers(13))
    size = max(1, int(np.prod(shape)) * kind.itemsize)
    if choice == 0:
        file[name] = h5py.ExternalLink(str(canary.with_suffix(".h5")), "v")
    elif choice == 1:
        file[name] = h5py.SoftLink(one(rng, ["/nothing", f"/{name}", "/v", "/"]))
    elif choice == 2:
        file.create_dataset(name, shape, kind, external=[(str(canary), 0, size)])
    elif choice == 3:
        layout = h5py.VirtualLayout(shape, kind)
        target = one(rng, [".", str(canary.with_suffix(".h5"))])
        layout[...] = h5py.VirtualSource(target, one(rng, ["v", name]), shape)
        file.create_virtual_dataset(name, layout)
    elif choice == 4:
        file.create_group(name)
    elif choice == 5:
        many = [int(one(rng, [1, 2**10, 2**20, 2**28, 2**40])), *shape[1:]]
        cut = (min(1024, many[0]), *shape[1:]) if len(shape) else None
        file.create_dataset(name, many, kind, chunks=cut and tuple(max(1, c) for c in cut))
    elif choice == 6:
        big = (int(one(rng, [2**16, 2**20, 2**24])), *(max(1, s) for s in shape[1:]))
        most = (None, *shape[1:])
        file.create_dataset(name, shape, kind, chunks=big, maxshape=most, compression=1)
    elif choice == 7:
        other = one(rng, ["f4", "f8", "i8", "u8", "S5", "?", "i1", "u2", "c16", "f2"])
        file[name] = np.zeros(shape, other)
    elif choice == 8:
        axes = [int(n) for n in rng.integers(0, 70, int(rng.integers(0, 5)))]
        file[name] = np.zeros(axes, kind)
    elif choice == 9 and values is not None:
        made = np.array(values)
        if made.size:
            flat, at = made.reshape(-1), int(rng.integers(made.size))
            with np.errstate(all="ignore"):
                flat[at : at + int(rng.integers(1, 9))] = np.asarray(
                    one(rng, _NUMBERS) if kind.kind == "f" else one(rng, _WORDS)
                ).astype(kind)
            made = flat.reshape(made.shape)
        file[name] = made
    elif choice == 10:
        packed = dict(chunks=chunks or tuple(max(1, s) for s in shape), compression=9)
        file.create_dataset(name, shape, kind, **packed)
        bomb = _bomb()
        file[name].id.write_direct_chunk((0,) * len(shape), bomb)
    elif choice == 11:
        file.create_dataset(name, dtype=kind, shape=None)
    if name in file and file.get(name, getlink=True).__class__ is h5py.HardLink:
        if rng.random() < 0.7:
            file[name].attrs.update(marks)


_BOMBS: list[bytes] = []


def _bomb() -> bytes:
    """64 kB that unpack to 64 MB."""
    import zlib

    if not _BOMBS:
        _BOMBS.append(zlib.compress(bytes(1 << 26), 9))
    return _BOMBS[0]


def _value(rng: Rng) -> Any:
    return one(
        rng,
        [
            *_NUMBERS, "", "V", "tomojax-recording", "\n\x1b[31m", 1, 2, -1, 2**40,
            np.float32(1e-5), np.zeros(0), np.zeros(3), np.zeros((64, 2)), b"bytes", True,
            "[" * 5000, "{}", h5py.Empty("f4"), np.arange(4000.0), [1e-3, 1e-3],
        ],
    )  # fmt: skip


def jsons(content: bytes, rng: Rng) -> bytes:
    """A value replaced, removed or added anywhere; or brackets without end."""
    if rng.random() < 0.3:
        return bytes_of(content, rng)
    told = json.loads(content)
    for _ in range(int(rng.integers(1, 3))):
        at, holder, key = told, None, None
        while isinstance(at, dict | list) and at and (holder is None or rng.random() < 0.7):
            holder = at
            key = one(rng, list(at)) if isinstance(at, dict) else int(rng.integers(len(at)))
            at = at[key]
        if holder is None:
            break
        new = one(
            rng,
            [None, True, [], {}, "x", -1, 0, 1e300, 1e-300, "", [[1, 2], [3]], [1, "a"],
             {"a": 1}, [0.0] * 3, [0.0] * 65, 10**400, [[0.0, 0.0]] * 64, [[0, 0, 0]] * 64,
             float("nan"), float("inf"), "2026-13-45", "2026-01-01", [None] * 64],
        )  # fmt: skip
        if rng.random() < 0.15:
            del holder[key]
        elif rng.random() < 0.1 and isinstance(holder, dict):
            holder[one(rng, ["extra", "schema", "__class__"])] = new
        else:
            holder[key] = new
    text = json.dumps(told)
    if rng.random() < 0.05:
        text = one(rng, ["[", '{"a":']) * int(rng.integers(1, 200_000)) + text
    return text.encode()


def npz(content: bytes, rng: Rng) -> bytes:
    """Members replaced, headers that lie, packs cut off, or bytes."""
    if rng.random() < 0.4:
        return bytes_of(content, rng)
    with zipfile.ZipFile(io.BytesIO(content)) as pack:
        members = {n: pack.read(n) for n in pack.namelist()}
    name = one(rng, list(members))
    choice = int(rng.integers(6))
    if choice == 0:
        del members[name]
    elif choice == 1:
        members[name] = bytes_of(members[name], rng)
    elif choice == 2:
        wrong = one(rng, ["f4", "i8", "S3", "O", "?", "c16", "u1"])
        shape = tuple(int(n) for n in rng.integers(0, 9, int(rng.integers(0, 5))))
        raw = io.BytesIO()
        np.save(raw, np.zeros(shape, wrong), allow_pickle=True)  # what must be refused
        members[name] = raw.getvalue()
    elif choice == 3:
        head = members[name]
        size = str(one(rng, [2**20, 2**31, 2**40, -1, 10**400])).encode()
        members[name] = head.replace(b"(", b"(" + size + b", ", 1)
    elif choice == 4:
        members[name] = members[name][: int(rng.integers(len(members[name])))]
    else:
        members[name] = members[name] + bytes(1 << 25)
    raw = io.BytesIO()
    with zipfile.ZipFile(
        raw, "w", one(rng, [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    ) as p:
        for key, value in members.items():
            p.writestr(key, value)
    return raw.getvalue()


def text(content: bytes, rng: Rng) -> bytes:
    """Words of a text replaced by others."""
    if rng.random() < 0.4:
        return bytes_of(content, rng)
    words = content.split(b" ")
    for _ in range(int(rng.integers(1, 4))):
        new = [
            b"",
            b"nan",
            b"1e999",
            b"\xff\xfe",
            b"\n",
            b",",
            b"[" * 5000,
            b'"',
            b"=",
            b"#",
        ]
        words[int(rng.integers(len(words)))] = one(rng, new)
    return b" ".join(words)


def mutations(kind: str, canary: Path) -> Callable[[bytes, Rng], bytes]:
    """The mutation of a format."""
    if kind in ("recording", "matlab", "results", "resumed"):
        return lambda c, r: hdf5(c, r, canary) if r.random() < 0.5 else bytes_of(c, r)
    if kind in ("policy", "places_npz", "scene", "recording_npz"):
        return npz
    if kind == "calibration":
        return jsons
    if kind in ("places_csv", "config", "recording_csv", "sidecar"):
        return text
    return bytes_of
