"""`tomojax stability`: where methods fail, and what they say then."""

import json
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from tomojax._environment import environment


@click.command()
@click.option("--quick", is_flag=True, help="Four methods, few scenes; some minutes.")
@click.option("--only", multiple=True, help="This sweep alone; may be given again.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("tomojax-stability"),
    show_default=True,
    help="Folder for the picture and rows; run again, it goes on where it was.",
)
@click.option(
    "--json",
    "json_path",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write limits and a summary here. [default: stability.json in the folder]",
)
@click.option("--scenes", type=int, help="At each value. [default: 10; quick: 4]")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option(
    "--like",
    type=click.Path(dir_okay=False, path_type=Path),
    help="A recording of the rig: its sheet and electrodes.",
)
def stability(
    quick: bool,
    only: tuple[str, ...],
    out: Path,
    json_path: Path | None,
    scenes: int | None,
    seed: int,
    like: Path | None,
) -> None:
    """Sweep noise, faults and scenes until each method fails; what it says beyond.

    On scenes whose voltages another model made: a resistor network with a rig's errors.
    """
    from tomojax import _stability, _stability_report
    from tomojax._recording import open_recording
    from tomojax._sensor import Sensor

    names = _stability.SWEEPS
    for name in only:
        if name not in names:
            raise ValueError(f"--only: got {name!r}, expected one of {', '.join(names)}")
    if scenes is not None and not 1 <= scenes <= 1000:
        raise ValueError(f"--scenes: got {scenes}, expected 1 to 1000")
    if seed < 0:
        raise ValueError(f"--seed: got {seed}, expected 0 or more")
    if json_path:
        json_path.parent.mkdir(parents=True, exist_ok=True)
    sensor = Sensor.grid(divisions=(64, 64), dtype=np.float32)
    if like is not None:
        with open_recording(like) as recording:
            sensor = recording.rig.sensor()
    with click.progressbar(
        length=len(only) or len(names) + 1,
        label="stability",
        file=sys.stderr,
        item_show_func=_named,
    ) as bar:
        rows = _stability.run(
            sensor,
            out,
            quick,
            only,
            scenes,
            seed,
            lambda done: bar.update(1, done),  # pyright: ignore
        )
        numbers = None
        if not only:
            numbers = _stability.numbers(out, quick)
            bar.update(1)
    limits = _stability.limits(rows)
    print(_stability_report.text(limits))
    flagged = _stability_report.flagged(limits)
    print(_stability_report.flagged_text(flagged))
    summary = {"flagged": flagged, "values": rows, "numbers": numbers}
    path = json_path or out / "stability.json"
    report = {"rows": limits, "summary": summary, "environment": environment()}
    path.write_text(json.dumps(report, indent=1) + "\n")
    picture = out / "stability.png"
    _stability_report.chart(rows, limits).savefig(picture, dpi=100)
    print(f"picture: {picture}")
    if numbers:
        print(_stability_report.numbers_text(numbers))
        picture = out / "stability_numbers.png"
        _stability_report.numbers_chart(numbers, limits).savefig(picture, dpi=100)
        print(f"picture: {picture}")


def _named(sweep: Any) -> str | None:
    return sweep
