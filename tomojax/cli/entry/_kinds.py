"""Tells the kind of a file by its first bytes, so that only our own files are replaced."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

# Suffixes of pictures that matplotlib draws without asking for more.
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps")

_SIGNATURES = (b"\x89PNG", b"%PDF", b"%!PS", b"\xff\xd8\xff", b"RIFF", b"II*", b"MM\0*")
_SIGNATURES += (b"GIF8",)
_OUTLINES = (b'{"type": "FeatureCollection"', b"<svg")
_HEAD = 1 << 12


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD)


def _json(path: Path) -> dict:
    try:
        found = json.loads(path.read_bytes())
    except (UnicodeDecodeError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _is_policy(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as file:
            return {"table.npy", "idle.npy"} <= set(file.namelist())
    except Exception:  # whatever zipfile makes of bytes that are no such file
        return False


def _is_calibration(path: Path) -> bool:
    if not _head(path).startswith(b"\x89HDF"):
        return _json(path).get("schema") == "tomojax-calibration"
    from tomojax.files import open_container

    try:
        with open_container(path) as file:
            return file.attributes.get("schema") == "tomojax-response"
    except (OSError, ValueError):
        return False


# Kind: what a file of it is called, and whether a file is one.
KINDS: dict[str, tuple[str, Callable[[Path], bool]]] = {
    "csv": ("a table of export", lambda path: b"t_s," in _head(path)[:20]),
    "film": (
        "a film",
        lambda path: _head(path)[:4] == b"GIF8" or _head(path)[4:8] == b"ftyp",
    ),
    "mcap": ("an MCAP file", lambda path: _head(path).startswith(b"\x89MCAP0")),
    "netcdf": ("a NetCDF file", lambda path: _head(path).startswith(b"\x89HDF")),
    "parquet": ("a Parquet file", lambda path: _head(path).startswith(b"PAR1")),
    "svg": ("an SVG picture", lambda path: b"<svg" in _head(path)),
    "calibration": ("a calibration", _is_calibration),
    "order": ("an order of check", lambda path: b"channels = [" in _head(path)),
    "outlines": ("outlines", lambda path: _head(path).startswith(_OUTLINES)),
    "picture": (
        "a picture",
        lambda path: _head(path).startswith(_SIGNATURES) or b"<svg" in _head(path),
    ),
    "policy": ("a policy", _is_policy),
    "report": ("a report of --json", lambda path: "environment" in _json(path)),
    "view": ("a view of rerun", lambda path: _head(path).startswith(b"RRF")),
}
