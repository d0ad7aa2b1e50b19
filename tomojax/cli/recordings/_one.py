"""Reconstructs one recording, and tells what was found."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tomojax._require import naming, require, require_library
from tomojax.cli import entry
from tomojax.cli.compiled import Compiling, compiling, keep_compiled
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

    follows = options["method"] == "follow"
    names = "method", "rate", "images", "lam", "grid", "contacts", "threshold", "chunk"
    given = {name: options[name] for name in (*names, "tare", "adapt")}
    if given["images"] is None:
        given["images"] = not follows and given["rate"] != "slot"
    files = ("calibration", "policy")
    given |= {name: str(options[name]) if options[name] else None for name in files}
    settings = Settings(**given)
    if options["outlines"]:
        check_outlines(options["outlines"], settings.method, settings.images)
    return settings


@contextmanager
def cluster(address: str | None) -> Iterator[Any]:
    """Gives a client of the Dask cluster at an address, or of a scheduler's file; or None.

    The cluster's workers keep compiled programs as this command does.
    """
    if address is None:
        yield None
        return
    require_library("distributed", "cluster")
    import distributed

    with naming("--cluster"):
        there = Path(address).is_file()
        require(there or ":" in address, "--cluster", address, "HOST:PORT, or a file")
        name = "scheduler_file" if there else "address"
        given: dict[str, Any] = {name: address, "set_as_default": False}
        client = distributed.Client(**given)
    with client:
        keeps: Any = distributed.WorkerPlugin()
        keeps.setup = _keep
        client.register_plugin(keeps, "tomojax")
        yield client


def _keep(worker: Any) -> None:
    keep_compiled()


def reconstruct_one(rec: Path, out: Path, options: dict[str, Any]) -> None:
    """Makes the results of a recording, and tells of them."""
    with opened(rec, **stretch(options)) as recording:
        # JAX is imported from here on: what is wrong with REC is told without.
        from tomojax._programs import foreseen

        with foreseen(f"{options['method']} {options['rate']} {recording.slots}"):
            compiled = _reconstructed(recording, out, settings_of(options), options)
    _tell(out, compiled, options)


def _reconstructed(
    recording: Any, out: Path, settings: Any, options: dict[str, Any]
) -> Compiling:
    """Makes the results; returns what was compiled."""
    from tomojax.results import reconstruct_recording

    given = {name: options[name] for name in ("resume", "overwrite")}
    with (
        entry.Progress("reconstruct", "chunks") as progress,
        entry.interrupts(),
        cluster(options["cluster"]) as client,
    ):
        begun = lambda: progress.above(COMPILING.format(settings.method))  # noqa: E731
        with compiling(progress.say, begun) as compiled:
            told = {"client": client, "progress": progress}
            reconstruct_recording(recording, out, settings, **given, **told)
    return compiled


def _tell(out: Path, compiled: Compiling, options: dict[str, Any]) -> None:
    """Prints and writes what is asked for of results that are there."""
    from tomojax.results import report, write_outlines

    if options["verbose"]:
        print(compiled.table())
    summary = report.summary(out)
    print(report.text(summary, out))
    entry.write_report(options["json_path"], rows=summary.pop("rows"), summary=summary)
    if options["outlines"]:
        count = write_outlines(out, options["outlines"])
        print(f"outlines: {count} in {options['outlines']}")
    if options["picture"]:
        from tomojax.results.plots import timeline

        entry.save_picture(timeline(out), options["picture"])
