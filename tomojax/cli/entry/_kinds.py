"""Tells the kind of a file by its first bytes, so that only our own files are replaced."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

# Suffixes of pictures that matplotlib draws without asking for more.
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".eps")

_SIGNATURES = (b"\x89PNG", b"%PDF", b"%!PS", b"\xff\xd8\xff", b"RIFF", b"II*", b"MM\0*")
_SIGNATURES += (b"GIF8",)
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


def _is_picture(path: Path) -> bool:
    head = _head(path)
    return head.startswith(_SIGNATURES) or b"<svg" in head


def _is_outlines(path: Path) -> bool:
    head = _head(path)
    return head.startswith((b'{"type": "FeatureCollection"', b"<svg"))


def _is_policy(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as file:
            return {"table.npy", "idle.npy"} <= set(file.namelist())
    except Exception:  # whatever zipfile makes of bytes that are no such file
        return False


def _is_report(path: Path) -> bool:
    return "environment" in _json(path)


def _is_calibration(path: Path) -> bool:
    return _json(path).get("schema") == "tomojax-calibration"


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
    "outlines": ("outlines", _is_outlines),
    "picture": ("a picture", _is_picture),
    "policy": ("a policy", _is_policy),
    "report": ("a report of --json", _is_report),
    "view": ("a view of rerun", lambda path: _head(path).startswith(b"RRF")),
}
