"""`tomojax repair`: corrects in a recording what only a person may decide."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import require
from tomojax.cli import entry

_NAMES = (
    "f_switch", "scale", "offset", "drive_voltage", "ground_resistance",
    "sheet_resistance", "electrode_diameter", "size", "notes", "units",
)  # fmt: skip


def _header(context: click.Context, parameter: Any, values: tuple[str, ...]) -> dict:
    found: dict[str, Any] = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not equals or name not in _NAMES:
            expected = ", ".join(f"{n}=…" for n in _NAMES)
            raise click.BadParameter(f"got {value!r}, expected one of {expected}")
        if name in ("notes", "units"):
            found[name] = text
            continue
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            raise click.BadParameter(f"{name}: got {text!r}, expected numbers") from None
        found[name] = numbers if name == "size" else numbers[0]
        if name != "size" and len(numbers) != 1:
            raise click.BadParameter(f"{name}: got {text!r}, expected one number")
    return found


@click.command(cls=entry.Command)
@click.argument("rec", type=entry.InputFile())
@entry.out_option(
    entry.OutputFile("recording"),
    "Write the repaired recording here, a new file.",
    required=True,
)
@click.option(
    "--set",
    "header",
    multiple=True,
    metavar="NAME=VALUE",
    callback=_header,
    help="Give an attribute the value that it should have had, in SI units: "
    "f_switch=5000. May be repeated.",
)
@click.option(
    "--scans",
    type=entry.Pair(int, "FIRST:BEHIND", mark=":"),
    help="Keep the scans from FIRST to the one before BEHIND. [default: all]",
)
@click.option(
    "--order",
    type=entry.InputFile(),
    help="Put channels and grounds in the order of this file of `tomojax check --write`.",
)
@click.option(
    "--join",
    type=entry.COUNT,
    default=1,
    help="Make one scan of so many, as of a rig's single slots: 64 after `record "
    "--pattern all`.",
)
@entry.stretch_options
def repair(
    rec: Path, out: Path, scans: Any, order: Path | None, join: int, **options: Any
) -> None:
    """Write the recording REC as it should have been.

    REC itself stays as it is. Every command that reads REC puts right clocks that fall,
    stand or begin anew. This command writes the corrected times into the new file.
    """
    from tomojax.files import read_toml
    from tomojax.recordings import between, open_recording, repair_recording

    if out.exists():
        raise ValueError(f"{out}: is there; give another name")
    order_of = {} if order is None else read_toml(order, "no order of channels")
    unknown = sorted(order_of.keys() - {"channels", "grounds"})
    require(not unknown, f"{order}", ", ".join(unknown[:1]), "channels and grounds")
    hdf5 = rec.suffix.lower() != ".tdms"
    require(hdf5, f"{rec}", "TDMS", "a recording in HDF5")
    part = options["since"], options["until"]
    alone = scans is None or part == (None, None)
    require(alone, "--scans", "--from or --to as well", "one of them")
    with (
        open_recording(rec, header=options["header"]) as recording,
        entry.Progress("repair", "scans") as progress,
    ):
        scans = scans or between(recording, *part).stretch
        given = order_of.get("channels"), order_of.get("grounds")
        repair_recording(recording, out, scans, *given, join, progress)  # pyright: ignore
        told = recording.mended
    for sentence in told:
        print(f"put right: {sentence}")
    if join > 1:
        _tell_twice(out)
    print(f"recording: {out}")


def _tell_twice(out: Path) -> None:
    """Says of joined scans that they have a ground twice: the number may be wrong."""
    import numpy as np

    from tomojax.recordings import open_recording

    with open_recording(out) as joined:
        scans = min(joined.scans, 1000)
        grounds = np.sort(joined.read(0, scans).grounds, 1)
    if twice := int((np.diff(grounds, axis=1) == 0).any(1).sum()):
        print(
            f"{twice} of {scans} scans have a ground twice: --join is the number of slots "
            "after which a pattern begins again; a policy that chooses has none"
        )
