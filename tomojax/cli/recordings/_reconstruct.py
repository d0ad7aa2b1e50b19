"""`tomojax reconstruct`: finds contacts and images in recordings."""

import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from tomojax._whole import whole, write_text
from tomojax.cli.entry import (
    check_name,
    Command,
    InputFile,
    interrupts,
    METHODS,
    NUMBER,
    OutputFile,
    STOPPED,
    stopped,
    stretch_options,
)
from tomojax.cli.recordings._opened import layout_option, opened

# Where results of several recordings go.
_FOLDER = Path("tomojax-results")

# Said as the first program begins; and seconds between lines where there is no bar.
_COMPILING = (
    "preparing {}: its programs are compiled the first time, which takes up to a minute or "
    "two; later runs start in seconds"
)
_NEWS = 10.0


def _lam(context: click.Context, parameter: Any, value: str) -> float | None:
    if value == "auto":
        return None
    return NUMBER.convert(value, parameter, context)


@click.command(cls=Command)
@click.argument("rec", type=InputFile(empty=True), nargs=-1, required=True)
@click.option(
    "-o",
    "--out",
    type=OutputFile(
        "results",
        lambda given: _results_of(given["rec"]),
        unless=lambda given: _several(given["rec"]),
    ),
    help="Write the results to this file, or to this folder for several recordings. "
    "[default: REC.results.h5; tomojax-results]",
)
@click.option(
    "--rate",
    type=click.Choice(["scan", "slot"]),
    help="Make a row for each scan or for each slot. [default: scan; slot with --method "
    "follow]",
)
@click.option(
    "--method",
    help="Reconstruct by auto, points, shape, source, positive, conductance, linear or "
    "follow. The method follow carries contacts on from slot to slot. [default: "
    "auto; source with --rate slot]",
)
@click.option(
    "--images/--no-images",
    default=None,
    help="Keep an image of each row. [default: only with --rate scan]",
)
@click.option(
    "--lam",
    default="auto",
    show_default=True,
    callback=_lam,
    help="Regularisation weight λ, or auto.",
)
@click.option(
    "--grid", type=int, help="Pixels along a side. [default: 32; 24 with --rate slot]"
)
@click.option(
    "--contacts",
    type=int,
    default=4,
    show_default=True,
    help="Find this many contacts per row at most.",
)
@click.option(
    "--threshold",
    type=NUMBER,
    help="Report no contact if all voltages are below this, V. [default: the method's]",
)
@click.option("--calibration", type=InputFile(), help="Apply this calibration of the rig.")
@click.option(
    "--tare/--no-tare",
    default=True,
    help="Take channels' zeros from contact-free slots, if there are any. [default: tare]",
)
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift slowly; the results log them.",
)
@click.option(
    "--policy",
    type=InputFile(),
    help="Use only the slots that this table chooses in each scan, and its λ. `tomojax "
    "design --policy` writes the table.",
)
@click.option(
    "--chunk", type=int, help="Scans to work on at once. [default: by memory and time]"
)
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
    help="Write outlines of what touches to this .geojson or .svg file; needs --method "
    "shape. Replaces earlier outlines.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report"),
    help="Write the printed summary here; replaces an earlier report.",
)
@click.option(
    "--verbose", is_flag=True, help="Print each compiled program, and how long it took, s."
)
@click.option("--coordinator", help="Share the work; HOST:PORT of process 0.")
@click.option("--processes", type=int, help="Processes that share the work.")
@click.option("--process", type=int, help="This process's number, from 0.")
@layout_option
@stretch_options
def reconstruct(rec: Sequence[Path], out: Path | None, **options: Any) -> None:
    """Find contacts and images in the recording REC.

    Each scan or slot of REC gives one row of results. Several recordings, or a folder, give
    one results file each in the folder OUT. OUT/table.csv has a line for each recording. A
    recording that cannot be read gives a line on standard error, and the exit status is 2.

    Ctrl-C, a crash or a full disk leave OUT.partial. --resume goes on with OUT.partial, and
    makes the same file as an unbroken run. To share the work, run one command on each of
    several machines that share a folder. Give each command the same --coordinator and
    --processes. Start a killed command again with --resume.
    """
    method = options["method"]
    check_name("--method", method or METHODS[0], (*METHODS, "follow"))
    if _several(rec):
        _all(rec, out or _FOLDER, options)
        return
    assert out is not None
    _one(rec[0], out, options)


def _several(rec: Sequence[Path]) -> bool:
    return len(rec) > 1 or rec[0].is_dir()


def _settings(options: dict[str, Any]) -> Any:
    from tomojax.results import check_outlines, default_method, Settings

    shared = [options[n] for n in ("coordinator", "processes", "process")]
    follows = options["method"] == "follow"
    if follows and any(value is not None for value in shared):
        raise ValueError("--coordinator: follow goes from slot to slot; use one process")
    if options["adapt"] and any(value is not None for value in shared):
        raise ValueError("--coordinator: --adapt goes in order; use one process")
    images = options["images"]
    rate = options["rate"] or ("slot" if follows else "scan")
    names = "lam", "grid", "contacts", "threshold", "chunk", "tare", "adapt"
    given = {name: options[name] for name in names}
    files = ("calibration", "policy")
    given |= {name: str(options[name]) if options[name] else None for name in files}
    settings = Settings(
        method=options["method"] or default_method(rate),
        rate=rate,
        images=rate == "scan" if images is None else images,
        **given,
    )
    if options["outlines"]:
        check_outlines(options["outlines"], settings.method, settings.images)
    return settings


def _one(rec: Path, out: Path, options: dict[str, Any]) -> None:
    with opened(rec, options["layout"], options["since"], options["until"]) as recording:
        # JAX is imported from here on: what is wrong with REC is told without.
        settings = _settings(options)
        share, compiled = _reconstructed(recording, out, settings, options)
    _tell(out, share, compiled, options)


def _reconstructed(
    recording: Any, out: Path, settings: Any, options: dict[str, Any]
) -> tuple[tuple[int, int], Any]:
    """Makes the results; which share of them this process had, and what it compiled."""
    from tomojax.cli.compiled import compiling
    from tomojax.results import distributed, reconstruct_recording

    given = [options[n] for n in ("coordinator", "processes", "process")]
    share = distributed.join(*given, out=out, resume=options["resume"])
    news = _news()

    with _bar(share) as bar, interrupts() as interrupted, ExitStack() as stack:

        def say(text: str) -> None:
            bar.set_postfix_str(text)
            news(text)

        begun = _said_once(settings.method)
        compiled = stack.enter_context(compiling(say, begun))

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)
            news(f"{done} of {total} chunks")
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
    return share, compiled


def _tell(
    out: Path, share: tuple[int, int], compiled: Any, options: dict[str, Any]
) -> None:
    """Prints and writes what is asked for of results that are there."""
    from tomojax._environment import environment
    from tomojax.results import report, write_outlines

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


def _all(given: Sequence[Path], out: Path, options: dict[str, Any]) -> None:
    """Reconstructs all with the same settings; a rig's first compiles the programs."""
    from tomojax.cli.compiled import compiling
    from tomojax.cli.recordings import _many

    for name in ("picture", "outlines", "coordinator", "processes", "process"):
        if options[name] is not None:
            raise ValueError(f"--{name}: got several recordings, expected one")
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out: {out}: got a file, expected a folder for several")
    if not out.absolute().parent.is_dir():
        raise ValueError(f"{out}: no such folder; make it, or give another")
    recordings = _many.found_in(given)
    settings = _settings(options)
    from tomojax.results import reconstruct_recording

    begun = _said_once(settings.method)
    with interrupts() as interrupted, compiling(begun=begun):

        def work(rec: Path, place: Path, say: Any) -> None:
            def progress(done: int, total: int) -> None:
                say(f"{done} of {total} chunks")
                if interrupted.is_set():
                    raise KeyboardInterrupt

            since, until = options["since"], options["until"]
            with opened(rec, options["layout"], since, until) as recording:
                reconstruct_recording(
                    recording,
                    place,
                    settings,
                    resume=options["resume"],
                    overwrite=options["overwrite"],
                    progress=progress,
                )
            if interrupted.is_set():
                raise KeyboardInterrupt

        fresh = not (options["resume"] or options["overwrite"])
        try:
            rows, wrong = _many.reconstruct_all(recordings, out, work, fresh)
        except _many.Stopped as error:
            print(f"\n{error}", file=sys.stderr)
            raise SystemExit(STOPPED) from None
    print(_many.text(rows, wrong, out))
    if options["json_path"]:
        _many.write_json(rows, options["json_path"])
    if wrong:
        raise SystemExit(2)


def _results_of(rec: Sequence[Path]) -> Path | None:
    return None if _several(rec) else rec[0].with_name(rec[0].stem + ".results.h5")


def _bar(share: tuple[int, int]):
    from tqdm import tqdm

    return tqdm(desc="reconstruct", unit="chunk", disable=None, position=share[0])


def _said_once(method: str) -> Callable[[], None]:
    """Says what goes on before the first result; above a bar, where there is one."""
    from tqdm import tqdm

    return lambda: tqdm.write(_COMPILING.format(method), file=sys.stderr)


def _news() -> Callable[[str], None]:
    """Tells now and then what goes on, where there is no bar."""
    began = last = time.monotonic()

    def tell(text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if text and now - last > _NEWS and not sys.stderr.isatty():
            last = now
            print(f"{text}; {now - began:.0f} s so far", file=sys.stderr)

    return tell
