"""Options and checks of `tomojax frontier` and `tomojax stability`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from tomojax.cli.entry import InputFile, OutputFile, OutputFolder


def study_options(name: str, report: str, scenes: str) -> Callable[[Any], Any]:
    """Returns a decorator with a study's options; the study leaves `name`.json and
    pictures.
    """
    options = (
        click.option(
            "--out",
            type=OutputFolder(*_names(name), goes_on=True),
            default=Path(f"tomojax-{name}"),
            show_default=True,
            help="Folder for pictures and rows; a second run goes on where the first "
            "stopped.",
        ),
        click.option(
            "--json",
            "json_path",
            type=OutputFile(
                "report", lambda given: given["out"] / f"{name}.json", makes=True
            ),
            help=f"Write {report} here; replaces a report. [default: {name}.json in "
            "the folder]",
        ),
        click.option(
            "--scenes", type=int, help=f"Number of scenes, {scenes[0].lower()}{scenes[1:]}"
        ),
        click.option(
            "--seed",
            type=int,
            default=0,
            show_default=True,
            help="Draw rigs and scenes from this seed; those from 1000000 on judge.",
        ),
        click.option(
            "--like",
            type=InputFile(),
            help="Take the sheet and electrodes from this recording of the rig. "
            "[default: the paper's sensor]",
        ),
    )

    def wrapped(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return wrapped


def _names(name: str) -> list[str]:
    """Lists the files in the folder, beside the report."""
    pictures = {
        "frontier": ("frontier.png",),
        "stability": ("stability.png", "stability_numbers.png"),
    }[name]
    kept = ("-run.json", "-rows.jsonl", "-scenes.npz")
    return [*pictures, *(name + suffix for suffix in kept)]


def begin(
    json_path: Path | None, scenes: int | None, least: int, seed: int, like: Path | None
) -> Any:
    """Checks the options, and returns the sensor.

    **Raises:** `ValueError` for fewer scenes than `least`, or over 1000, and for a negative
    seed.
    """
    import numpy as np

    from tomojax.recordings import open_recording
    from tomojax.sensor import Sensor

    if scenes is not None and not least <= scenes <= 1000:
        raise ValueError(f"--scenes: got {scenes}, expected {least} to 1000")
    if seed < 0:
        raise ValueError(f"--seed: got {seed}, expected 0 or more")
    if json_path:
        json_path.parent.mkdir(parents=True, exist_ok=True)
    if like is None:
        return Sensor.grid(divisions=(64, 64), dtype=np.float32)
    with open_recording(like) as recording:
        return recording.rig.sensor()


def named(job: Any) -> str | None:
    """Returns the job's name, which stands beside the progress bar."""
    return job
