"""Reconstructs one recording, and tells what was found."""

from pathlib import Path
from typing import Any

from tomojax.cli import entry
from tomojax.cli.compiled import Compiling, compiling
from tomojax.cli.recordings._opened import opened, stretch

# Said as the first program begins.
COMPILING = (
    "preparing {}: its programs are compiled the first time, which takes up to a minute or "
    "two; later runs start in seconds"
)


def settings_of(options: dict[str, Any]) -> Any:
    """Returns the `Settings` that the command's options ask for.

    **Raises:** `ValueError` for options that do not go together.
    """
    from tomojax.results import check_outlines, Settings

    shared = any(options[n] is not None for n in ("coordinator", "processes", "process"))
    follows = options["method"] == "follow"
    names = "method", "rate", "images", "lam", "grid", "contacts", "threshold", "chunk"
    given = {name: options[name] for name in (*names, "tare", "adapt")}
    if given["images"] is None:
        given["images"] = not follows and given["rate"] != "slot"
    files = ("calibration", "policy")
    given |= {name: str(options[name]) if options[name] else None for name in files}
    settings = Settings(**given)
    if shared and settings.in_order:
        raise ValueError(f"--coordinator: {settings.in_order}; use one process")
    if options["outlines"]:
        check_outlines(options["outlines"], settings.method, settings.images)
    return settings


def reconstruct_one(rec: Path, out: Path, options: dict[str, Any]) -> None:
    """Makes the results of a recording, and tells of them."""
    with opened(rec, **stretch(options)) as recording:
        # JAX is imported from here on: what is wrong with REC is told without.
        share, compiled = _reconstructed(recording, out, settings_of(options), options)
    _tell(out, share, compiled, options)


def _reconstructed(
    recording: Any, out: Path, settings: Any, options: dict[str, Any]
) -> tuple[tuple[int, int], Compiling]:
    """Makes the results; which share of them this process had, and what it compiled."""
    from tomojax.results import distributed, reconstruct_recording

    given = [options[n] for n in ("coordinator", "processes", "process")]
    share = distributed.join(*given, out=out, resume=options["resume"])
    with entry.Progress("reconstruct", "chunks") as progress, entry.interrupts():
        begun = lambda: progress.above(COMPILING.format(settings.method))  # noqa: E731
        with compiling(progress.say, begun) as compiled:
            given = {name: options[name] for name in ("resume", "overwrite")}
            told = {"share": share, "progress": progress}
            reconstruct_recording(recording, out, settings, **given, **told)
    distributed.leave(share, out)
    return share, compiled


def _tell(
    out: Path, share: tuple[int, int], compiled: Compiling, options: dict[str, Any]
) -> None:
    """Prints and writes what is asked for of results that are there."""
    from tomojax.results import report, write_outlines

    if options["verbose"]:
        print(compiled.table())
    if share[0] > 0:
        print(f"process {share[0]} of {share[1]}: done; process 0 names the file")
        return
    summary = report.summary(out)
    print(report.text(summary, out))
    entry.write_report(options["json_path"], rows=summary.pop("rows"), summary=summary)
    if options["outlines"]:
        count = write_outlines(out, options["outlines"])
        print(f"outlines: {count} in {options['outlines']}")
    if options["picture"]:
        from tomojax.results.plots import timeline

        entry.save_picture(timeline(out), options["picture"])
