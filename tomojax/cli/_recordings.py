"""Commands on recordings: `tomojax reconstruct` and `tomojax info`."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from tomojax._whole import whole, write_text
from tomojax.cli.entry import (
    Command,
    InputFile,
    interrupts,
    NUMBER,
    OutputFile,
    STOPPED,
    stopped,
)


def _tdms(context: click.Context, parameter: Any, values: tuple[str, ...]) -> dict:
    names = ("group", "channels", "ground", "slots", "rail")
    options = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not equals or name not in names:
            expected = ", ".join(f"{n}=…" for n in names)
            raise click.BadParameter(f"got {value!r}, expected one of {expected}")
        options[name] = text
    return options


def _lam(context: click.Context, parameter: Any, value: str) -> float | None:
    if value == "auto":
        return None
    return NUMBER.convert(value, parameter, context)


tdms_option = click.option(
    "--tdms",
    multiple=True,
    metavar="NAME=TEXT",
    callback=_tdms,
    help="How a .tdms file is laid out: group=scan, channels=ai{}, ground=ground, "
    "slots=10, rail=5. Again for each.",
)


@click.command(cls=Command)
@click.argument("rec", type=InputFile())
@click.option(
    "-o",
    "--out",
    type=OutputFile("results", lambda given: _results_of(given["rec"])),
    help="Results file. [default: REC.results.h5]",
)
@click.option(
    "--rate",
    type=click.Choice(["scan", "slot"]),
    help="A row for each. [default: scan; slot with --method follow]",
)
@click.option(
    "--method",
    help="auto, points, shape, source, positive, conductance or linear; or follow, which "
    "carries contacts on from slot to slot. [default: auto; source with --rate slot]",
)
@click.option("--images/--no-images", default=None, help="[default: only with --rate scan]")
@click.option("--lam", default="auto", show_default=True, callback=_lam, help="λ, or auto.")
@click.option(
    "--grid", type=int, help="Pixels of a side. [default: 32; 24 with --rate slot]"
)
@click.option(
    "--contacts", type=int, default=4, show_default=True, help="At most, per row."
)
@click.option(
    "--threshold", type=NUMBER, help="V: less is no contact. [default: the method's]"
)
@click.option("--calibration", type=InputFile(), help="A calibration file of this rig.")
@click.option(
    "--tare/--no-tare",
    default=True,
    help="Take channels' zeros from contact-free slots, where there are. [default: tare]",
)
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift, slowly; the results log them.",
)
@click.option(
    "--policy",
    type=InputFile(),
    help="A table of `tomojax design --policy`: of each scan its slots alone, its λ.",
)
@click.option("--chunk", type=int, help="Scans that are worked on at once.")
@click.option("--resume", is_flag=True, help="Go on with a run that ended early.")
@click.option("--overwrite", is_flag=True, help="Begin anew over results that are there.")
@click.option(
    "--picture",
    type=OutputFile("picture"),
    help="Draw the contacts over time here (PNG); replaces a picture.",
)
@click.option(
    "--outlines",
    type=OutputFile("outlines"),
    help="Write the outlines of what touches here (.geojson or .svg), with --method "
    "shape; replaces outlines.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report"),
    help="Write the printed summary here; replaces an earlier one.",
)
@click.option("--verbose", is_flag=True, help="Print what was compiled, and for how long.")
@click.option("--coordinator", help="HOST:PORT of process 0, to share the work.")
@click.option("--processes", type=int, help="How many share it.")
@click.option("--process", type=int, help="Which of them this is, from 0.")
@tdms_option
def reconstruct(rec: Path, out: Path, **options: Any) -> None:
    """Contacts and images of every scan or slot of the recording REC.

    Ctrl-C, a crash or a full disk leave OUT.partial: --resume goes on with it, to the same
    file. On several machines that share a folder, run one command on each, with the same
    --coordinator and --processes; one that was killed is started again with --resume.
    """
    from tomojax._environment import environment
    from tomojax.cli.compiled import compiling
    from tomojax.recordings import open_recording
    from tomojax.results import (
        check_outlines,
        default_method,
        distributed,
        reconstruct_recording,
        report,
        Settings,
        write_outlines,
    )

    given = [options[n] for n in ("coordinator", "processes", "process")]
    follows = options["method"] == "follow"
    if follows and any(value is not None for value in given):
        raise ValueError("--coordinator: follow goes from slot to slot; use one process")
    if options["adapt"] and any(value is not None for value in given):
        raise ValueError("--coordinator: --adapt goes in order; use one process")
    share = distributed.join(*given, out=out, resume=options["resume"])
    images = options["images"]
    rate = options["rate"] or ("slot" if follows else "scan")
    settings = Settings(
        method=options["method"] or default_method(rate),
        rate=rate,
        images=rate == "scan" if images is None else images,
        lam=options["lam"],
        grid=options["grid"],
        contacts=options["contacts"],
        threshold=options["threshold"],
        chunk=options["chunk"],
        calibration=str(options["calibration"]) if options["calibration"] else None,
        policy=str(options["policy"]) if options["policy"] else None,
        tare=options["tare"],
        adapt=options["adapt"],
    )
    if options["outlines"]:
        check_outlines(options["outlines"], settings.method, settings.images)
    with (
        open_recording(rec, **options["tdms"]) as recording,
        _bar(share) as bar,
        interrupts() as interrupted,
        compiling(bar.set_postfix_str) as compiled,
    ):

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)
            if interrupted.is_set():
                raise KeyboardInterrupt

        try:
            reconstruct_recording(
                recording,
                out,
                settings,
                resume=options["resume"],
                overwrite=options["overwrite"],
                share=share,
                progress=progress,
            )
        except KeyboardInterrupt:
            bar.close()
            print(f"\n{stopped()}", file=sys.stderr)
            raise SystemExit(STOPPED) from None
    distributed.leave(share, out)
    if options["verbose"]:
        print(compiled.table())
    if share[0] > 0:
        print(f"process {share[0]} of {share[1]}: done; process 0 names the file")
        return
    summary = report.summary(out)
    print(report.text(summary, out))
    if options["json_path"]:
        told = {
            "rows": summary.pop("rows"),
            "summary": summary,
            "environment": environment(),
        }
        write_text(options["json_path"], json.dumps(told, indent=1) + "\n")
    if options["outlines"]:
        count = write_outlines(out, options["outlines"])
        print(f"outlines: {count} in {options['outlines']}")
    if options["picture"]:
        from tomojax.results.plots import timeline

        with whole(options["picture"]) as part:
            timeline(out).savefig(part, dpi=110)
        print(f"picture: {options['picture']}")


def _results_of(rec: Path) -> Path:
    return rec.with_name(rec.stem + ".results.h5")


def _bar(share: tuple[int, int]):
    from tqdm import tqdm

    return tqdm(desc="reconstruct", unit="chunk", disable=None, position=share[0])


@click.command(cls=Command)
@click.argument("rec", type=InputFile())
@click.option(
    "--calibration",
    type=InputFile(),
    help="Say how old this is, and whether REC still fits it.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report"),
    help="Write the rows and a summary here; replaces an earlier one.",
)
@tdms_option
def info(rec: Path, calibration: Path | None, json_path: Path | None, tdms: dict) -> None:
    """What the recording REC holds, and its faults."""
    from tomojax.bringup.signs import find_signs
    from tomojax.recordings import info, open_recording

    known = None
    with open_recording(rec, **tdms) as recording:
        if calibration is not None:
            from tomojax.sensor import Calibration  # imports JAX: REC alone needs none

            known = Calibration.load(calibration, recording.electrodes)
        summary = info.summary(recording)
        with _bar((0, 1)) as bar:
            bar.set_description("info")

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done - bar.n)

            rows = info.faults(recording, progress)
        signs = find_signs(recording)
        rows += [{"fault": s.text, "scans": None, "where": []} for s in signs]
        fit = None
        if known is not None:
            from tomojax.calibration import still_fits

            try:
                fit = still_fits(recording, known)
            except ValueError as error:
                raise ValueError(f"{calibration}: {error}") from None
    print(info.text(rec, summary, rows))
    if fit is not None:
        from tomojax.calibration import fit_text

        print(fit_text(fit))
        summary["calibration"] = {"file": str(calibration), **fit}
    if json_path:
        from tomojax._environment import environment

        report = {"rows": rows, "summary": summary, "environment": environment()}
        write_text(json_path, json.dumps(report, indent=1) + "\n")
