"""`tomojax demo`: reconstructs and draws the recordings that come with the package.

The touch recording is simulated; `python -m tomojax.cli._demo_recording` makes it anew. The
simulation has an uneven sheet, gain errors and noise, which the reconstruction is not told.
Letters and a hand come from a resistor network (`tomojax.cli._demo_shapes`).
"""

import sys
from importlib.resources import as_file, files
from pathlib import Path

import click

from tomojax._whole import whole
from tomojax.cli.entry import Command, OutputFolder


@click.command(cls=Command)
@click.option(
    "--out",
    type=OutputFolder("results.h5", "contacts.png", "contacts.gif", "shapes.png"),
    default=Path("tomojax-demo"),
    show_default=True,
    help="Folder for the pictures and the results.",
)
def demo(out: Path) -> None:
    """Reconstruct a small recording that comes with the package.

    The command prints the contacts that it finds. The results, two pictures and a clip go
    to the folder OUT.
    """
    from tqdm import tqdm

    from tomojax.exports import export
    from tomojax.recordings import open_recording
    from tomojax.results import plots, reconstruct_recording, report, Settings

    out.mkdir(parents=True, exist_ok=True)
    results = out / "results.h5"
    with as_file(files("tomojax") / "demo.h5") as path, open_recording(path) as recording:
        rig = recording.rig
        print(
            f"{recording.scans} scans of {recording.slots} slots, {recording.electrodes} "
            f"electrodes, {recording.scans * recording.interval:.3g} s: {rig.notes}"
        )
        reconstruct_recording(recording, results, Settings(grid=32), overwrite=True)
    print(report.text(report.summary(results), results))
    with whole(out / "contacts.png") as part:
        plots.timeline(results).savefig(part, dpi=110)
    with tqdm(desc="clip", disable=None, file=sys.stderr) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        # Two seconds as eight, in as many pictures as a clip on a page needs.
        clip = out / "contacts.gif"
        export(results, clip, "film", rate=12, slow=4.0, progress=progress)
    from tomojax.cli import _demo_shapes

    with as_file(files("tomojax") / "demo_shapes.npz") as path:
        with whole(out / "shapes.png") as part:
            _demo_shapes.draw(path, part)
    for name in ("contacts.png", "contacts.gif", "shapes.png"):
        print(f"picture: {out / name}")
