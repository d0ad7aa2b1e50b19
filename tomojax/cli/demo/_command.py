"""The command `tomojax demo`."""

from importlib.resources import as_file, files
from pathlib import Path

import click

from tomojax._whole import whole
from tomojax.cli.demo._scenes import SCENES
from tomojax.cli.entry import Command, OutputFolder, Progress, save_picture


@click.command(cls=Command)
@click.argument("scene", type=click.Choice(list(SCENES)), default="fingers")
@click.option("--list", "listed", is_flag=True, help="Print the scenes and end.")
@click.option(
    "--out",
    type=OutputFolder("results.h5", "demo.png", "demo.gif", "contacts.png"),
    default=Path("tomojax-demo"),
    show_default=True,
    help="Folder for the pictures and the results.",
)
def demo(scene: str, listed: bool, out: Path) -> None:
    """Reconstruct a recording that comes with the package, beside its truth.

    SCENE is fingers (the default), letters, spanner, palm, round or glove. The command
    prints the contacts and leaves a picture, a film and the results in a folder.
    """
    if listed:
        for name, told in SCENES.items():
            print(f"{name:8s} {told.words} (tomojax demo {name})")
        return
    from tomojax.cli.demo import _pictures
    from tomojax.files import open_container
    from tomojax.recordings import open_recording
    from tomojax.results import plots, reconstruct_recording, report, Settings

    shown, results = SCENES[scene], out / "results.h5"
    out.mkdir(parents=True, exist_ok=True)
    with as_file(files("tomojax") / shown.file) as path, open_recording(path) as recording:
        print(
            f"{recording.scans} scans of {recording.slots} slots, {recording.electrodes} "
            f"electrodes, {recording.scans * recording.interval:.3g} s: {shown.words}"
        )
        # What touched (scans, P, P), and the fingers' middles (scans, K, 2), m.
        with open_container(path) as file:
            touched, xy = (file.read(name) for name in ("truth_touched", "truth_xy"))
        settings = Settings(method=shown.method, grid=32)
        reconstruct_recording(recording, results, settings, overwrite=True)
        told = _pictures.Told(recording, touched, results)
    save_picture(_pictures.still(told, shown.words), out / "demo.png")
    print(report.text(report.summary(results), results))
    print(_judged(told, xy))
    with Progress("film") as progress, whole(out / "demo.gif") as part:
        _pictures.film(told, part, shown.slow, progress)
    print(f"film: {out / 'demo.gif'}")
    save_picture(plots.timeline(results), out / "contacts.png")


def _judged(told, xy) -> str:
    """Says how near the truth the results are: fingers by place, the rest by overlap."""
    import numpy as np

    there = np.isfinite(xy).all(-1)
    if there.any():
        rows = there.any(1)
        right = told.count == there.sum(1)
        far = np.linalg.norm(xy[:, :, None] - told.xy[:, None], axis=-1)
        error = np.where(np.isfinite(far), far, np.inf).min(-1)[there & right[:, None]]
        return (
            f"truth: the count is right in {100 * right[rows].mean():.1f} % of rows with a "
            f"touch; places are {1e3 * np.median(error):.2f} mm off in the median"
        )
    side = told.truth.shape[1] // told.found.shape[1]
    blocks = told.truth.reshape(len(told.truth), told.found.shape[1], side, -1, side)
    # Off the sheet both are NaN, and no more than that.
    truth, found = np.nan_to_num(blocks).mean((2, 4)) > 0.5, told.found > 0.5
    both, either = (truth & found).sum((1, 2)), (truth | found).sum((1, 2))
    rows = truth.any((1, 2))
    overlap = np.median(both[rows] / either[rows])
    return f"truth: found and true area share {100 * overlap:.0f} % in the median row"
