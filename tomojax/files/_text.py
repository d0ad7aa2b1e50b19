"""Reads small files of text: JSON and TOML."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

_SMALL = 1 << 24  # bytes; no calibration or order of wires comes near it


def read_json(path: Path | str, what: str) -> Any:
    """Reads the content of a JSON file.

    **Raises:** `ValueError`, one line: the file, the text `what`, and why.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.files import read_json
    >>> _ = Path("rig.json").write_text('{"gain": 2}')
    >>> read_json("rig.json", "not a calibration")
    {'gain': 2}
    >>> _ = Path("rig.json").write_text("[" * 100_000)
    >>> read_json("rig.json", "not a calibration")
    Traceback (most recent call last):
        ...
    ValueError: rig.json: not a calibration: brackets too deep
    """
    return _parsed(path, what, json.loads)


def read_toml(path: Path | str, what: str) -> dict[str, Any]:
    """Reads the content of a TOML file.

    **Raises:** `ValueError`, one line: the file, the text `what`, and why.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.files import read_toml
    >>> _ = Path("order.toml").write_text("channels = [1, 0]")
    >>> read_toml("order.toml", "no options")
    {'channels': [1, 0]}
    """
    return _parsed(path, what, tomllib.loads)


def _parsed(path: Path | str, what: str, parse: Callable[[str], Any]) -> Any:
    path = Path(path)
    _require_file(path, what, _SMALL)
    try:
        return parse(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError(f"{path}: {what}: brackets too deep") from None
    except (OSError, ValueError) as error:  # also of bytes that are no text
        raise ValueError(f"{path}: {what}: {_line(error)}") from None


def _require_file(path: Path, what: str, most: int) -> None:
    """Refuses all but plain files up to `most` bytes: a FIFO may be awaited for ever."""
    if not path.is_file():
        reason = "a folder" if path.is_dir() else "no such file"
        reason = "no plain file" if path.exists() and not path.is_dir() else reason
        raise ValueError(f"{path}: {what}: {reason}")
    size = path.stat().st_size
    if size > most:
        raise ValueError(f"{path}: {what}: got {size} bytes, expected up to {most}")


def _line(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:200]
