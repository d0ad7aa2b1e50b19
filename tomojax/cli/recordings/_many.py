"""Reconstructs several recordings: results of each, and one table of all."""

import csv
import json
import sys
import zipfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tomojax._require import require
from tomojax._whole import whole
from tomojax.cli import entry
from tomojax.cli.compiled import compiling
from tomojax.cli.recordings._one import cluster, COMPILING, settings_of
from tomojax.cli.recordings._opened import opened, stretch

# What recordings are called.
_TABLES = (".csv", ".tsv", ".txt")
_ENDINGS = (".h5", ".hdf5", ".mat", ".tdms", ".npz", ".mcap", *_TABLES)

# What lies beside them and is none.
_OURS = (".results.h5", ".track.h5", ".adapted.h5", ".response.h5")

# A table names the column of grounds in its first lines; exports and our own table do not.
_HEAD = 1 << 14

_COLUMNS = {
    "file": "",
    "status": "",
    "scans": "",
    "seconds": "s",
    "rows": "",
    "rows_with_contact": "",
    "rows_doubted": "",
    "rows_without_answer": "",
    "touches": "",
    "residual_median": "V",
    "took": "s",
    "results": "",
}


def reconstruct_all(given: Sequence[Path], out: Path, options: dict[str, Any]) -> None:
    """Reconstructs all with the same settings; a rig's first compiles the programs.

    **Raises:** `SystemExit` if a recording failed.
    """
    for name in ("picture", "outlines"):
        require(options[name] is None, f"--{name}", "several recordings", "one")
    fits = out.is_dir() or not out.exists()
    require(fits, f"--out: {out}", "a file", "a folder for several")
    if not out.absolute().parent.is_dir():
        raise ValueError(f"{out}: no such folder; make it, or give another")
    rows, wrong = _rows(found_in(given), out, options)
    print(text(rows, wrong, out))
    summary = {"recordings": len(rows), "done": len(rows) - wrong}
    entry.write_report(options["json_path"], rows=rows, summary=summary)
    if wrong:
        raise SystemExit(2)


def found_in(given: Sequence[Path]) -> list[Path]:
    """Lists the recordings that were named, and the recordings in named folders."""
    found: list[Path] = []
    for path in given:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(one for one in path.iterdir() if _is_recording(one))
        require(inside, f"{path}", "a folder without recordings", ", ".join(_ENDINGS))
        found += inside
    return list(dict.fromkeys(found))


def _is_recording(path: Path) -> bool:
    """Tells recordings from other files of a folder; a broken recording counts, too."""
    ending = path.suffix.lower()
    if ending not in _ENDINGS or path.name.endswith(_OURS) or not path.is_file():
        return False
    if ending in _TABLES:
        with path.open("rb") as file:
            return b"ground" in file.read(_HEAD).lower()
    if ending == ".npz":
        try:
            with zipfile.ZipFile(path) as pack:
                return {"v.npy", "ground.npy"} <= set(pack.namelist())
        except (OSError, ValueError, zipfile.BadZipFile):
            return True  # it says itself what is wrong
    return True


def _rows(
    found: list[Path], out: Path, options: dict[str, Any]
) -> tuple[list[dict[str, Any]], int]:
    """Reconstructs each recording; an error gives one line, and the next recording follows.

    Returns the rows of the table, and how many recordings failed. The table is written anew
    after each recording.
    """
    from tomojax.results import Made, reconstruct_many

    settings, rows = settings_of(options), []
    given = {name: options[name] for name in ("resume", "overwrite")}
    wrong = lambda: sum(row["status"] != "done" for row in rows)  # noqa: E731
    with (
        entry.Progress(unit="chunks") as progress,
        entry.interrupts(),
        cluster(options["cluster"]) as client,
    ):

        def begun(rec: Path) -> Any:
            label = f"{found.index(rec) + 1} of {len(found)}: {rec.name}"

            def told(done: int, total: int) -> None:
                progress.label = label
                progress(done, total)

            return told

        def done(made: Made) -> None:
            row = dict.fromkeys(_COLUMNS, "") | {"file": str(made.file)}
            row["took"] = f"{made.seconds:.2f}"
            if made.error is None:
                row |= {"status": "done", "results": str(made.results)}
                row |= _counted(made.results)
            else:
                row["status"] = " ".join(str(made.error).splitlines())
                progress.above(f"tomojax: {row['status']}")
            rows.append(row)
            write_table(rows, out / "table.csv")

        told = {"opened": partial(opened, **stretch(options)), "begun": begun, "done": done}
        first = lambda: progress.above(COMPILING.format(settings.method))  # noqa: E731
        try:
            with compiling(begun=first):
                reconstruct_many(found, out, settings, **given, client=client, **told)
        except KeyboardInterrupt:
            told = f"stopped after {len(rows) - wrong()} of {len(found)}"
            print(f"\ntomojax: {told}; --resume goes on in {out}", file=sys.stderr)
            raise SystemExit(entry.STOPPED) from None
    return rows, wrong()


def _counted(place: Path) -> dict[str, Any]:
    """Returns figures of one results file."""
    from tomojax.exports import Source
    from tomojax.results import report

    told = report.summary(place)
    by_count = told["rows_by_contacts"]
    with Source(place) as source:
        events = source.events()
    return {
        "scans": json.loads(source.attributes["configuration"])["scans"],
        "seconds": f"{told['duration_s']:.6g}",
        "rows": told["rows_in_all"],
        "rows_with_contact": sum(n for k, n in by_count.items() if k != "0"),
        "rows_doubted": told["rows_doubted"],
        "rows_without_answer": told["rows_without_answer"],
        "touches": sum(event.kind == "touch_down" for event in events),
        "residual_median": f"{told['residual_median_V']:.4g}",
    }


def write_table(rows: list[dict[str, Any]], path: Path) -> None:
    """Writes the table as CSV, with units in the columns' names."""
    names = [f"{n}_{unit}" if unit else n for n, unit in _COLUMNS.items()]
    with whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        to = csv.writer(file, lineterminator="\n")
        to.writerow(names)
        to.writerows([row[n] for n in _COLUMNS] for row in rows)


def text(rows: list[dict[str, Any]], wrong: int, out: Path) -> str:
    """Returns the table as text for people."""
    head = f"{'touches':>7s} {'rows':>8s} {'doubted':>8s} {'s':>8s}  file"
    lines = [
        f"{row['touches']!s:>7s} {row['rows']!s:>8s} {row['rows_doubted']!s:>8s} "
        f"{row['seconds']!s:>8s}  {Path(row['file']).name}"
        + ("" if row["status"] == "done" else "  NOT DONE")
        for row in rows
    ]
    done = f"{len(rows) - wrong} of {len(rows)} done; table: {out / 'table.csv'}"
    return "\n".join([head, *lines, done])
