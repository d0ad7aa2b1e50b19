"""`tomojax table1`: its bars, its JSON, its mistakes. The whole protocol, run once."""

import json
import subprocess
import sys

import pytest

KEYS = {
    "pattern",
    "slots",
    "dt_ms",
    "width_mm",
    "width_ratio",
    "paper_width_mm",
    "paper_dt_ms",
    "place_error_mm",
}


def table1(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from tomojax.cli import main; main()", "table1"]
    return subprocess.run([*command, *arguments], capture_output=True, text=True)


@pytest.mark.long
def test_predicts_the_paper(tmp_path) -> None:
    # One test of all that one run gives: the run takes most of a minute.
    out, pictures = tmp_path / "new" / "t.json", tmp_path / "pictures"
    run = table1("--json", str(out), "--out", str(pictures))
    assert run.returncode == 0, run.stderr
    report = json.loads(out.read_text())
    assert set(report) == {"rows", "summary", "environment"} and len(report["rows"]) == 9
    summary, rows = report["summary"], report["rows"]
    assert summary["width_rank_correlation"] >= 0.90
    assert summary["width_ratio_rms_relative_error"] <= 0.08
    assert summary["temporal_column_exact"]
    # From the rows themselves, not from the summary's word.
    assert all(r["dt_ms"] == pytest.approx(r["paper_dt_ms"], abs=1e-9) for r in rows)
    ours = [r["width_ratio"] for r in rows]
    paper = [r["paper_width_mm"] / 32.2 for r in rows]
    off = [(a / b - 1) ** 2 for a, b in zip(ours[1:], paper[1:])]
    assert (sum(off) / len(off)) ** 0.5 <= 0.08
    # One condition sets λ: the width of "all", and nothing else.
    assert rows[0]["pattern"] == "all" and rows[0]["width_mm"] == pytest.approx(
        32.2, abs=0.1
    )
    assert all(set(row) >= KEYS for row in report["rows"])
    assert report["environment"]["device"]
    names = ["dependence", "images", "table"]
    assert sorted(p.name for p in pictures.iterdir()) == [
        f"table1_{name}.png" for name in names
    ]
    for row in report["rows"]:
        assert row["pattern"] in run.stdout
    # How both figures move is in the JSON, for other margins, λ and another definition.
    found = report["summary"]["sensitivity"]
    assert len({r["margin_mm"] for r in found}) == 6
    assert len({r["lam"] for r in found}) == 12 and len({r["width"] for r in found}) == 2


@pytest.mark.parametrize("arguments", [["--json"], ["--csv", "x"], ["--json", "/"], ["x"]])
def test_mistakes_are_one_line(arguments) -> None:
    run = table1(*arguments)
    assert run.returncode == 2 and len(run.stderr.strip().splitlines()) == 1, run.stderr
