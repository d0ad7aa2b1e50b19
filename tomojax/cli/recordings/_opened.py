"""Opens a recording for a command: its layout, and a stretch of it."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import require


def _layout(context: click.Context, parameter: Any, values: tuple[str, ...]) -> dict:
    found = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not equals or not name:
            raise click.BadParameter(f"got {value!r}, expected NAME=TEXT")
        found[name] = text
    return found


layout_option = click.option(
    "--layout",
    "--tdms",
    multiple=True,
    metavar="NAME=TEXT",
    callback=_layout,
    help="Say how a file is laid out. A .tdms file takes group=scan, channels=ai{}, "
    "ground=ground, slots=10, rail=5. Other files take attributes that they lack: "
    "f_switch=5000, pitch=0.01. May be repeated.",
)


def stretch(options: dict[str, Any]) -> dict[str, Any]:
    """Picks the options of `opened` among a command's."""
    return {name: options[name] for name in ("layout", "since", "until")}


def opened(
    rec: Path, layout: dict, since: float | None = None, until: float | None = None
) -> Any:
    """Opens a recording, or a stretch of it; returns a context that closes the recording.

    **Raises:** `ValueError` with one line.
    """
    from tomojax.recordings import between, open_recording

    if rec.suffix.lower() == ".tdms":
        names = ("group", "channels", "ground", "slots", "rail")
        unknown = sorted(layout.keys() - set(names))
        require(not unknown, "--layout", unknown, f"some of {list(names)}")
        whole = open_recording(rec, **layout)
    else:
        whole = open_recording(rec, header=layout)
    try:
        return between(whole, since, until)
    except ValueError:
        whole.close()
        raise
