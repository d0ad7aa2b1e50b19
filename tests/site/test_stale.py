"""Figures on pages are as old as the code that they describe, or a page says why."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from benchmarks import stale  # noqa: E402


def test_stale_results_are_named_on_the_page() -> None:
    found, reasons = set(stale.stale()), stale.excused()
    assert found <= set(reasons), "make them anew, or say why in measured/older.md"
    assert set(reasons) <= found, "these are as old as their code: no reason is needed"
    assert all(reasons.values())


def test_every_result_names_its_code() -> None:
    kept = {path.stem for path in stale.RESULTS.glob("*.json")} - {stale.CODE.stem}
    assert kept <= set(json.loads(stale.CODE.read_text()))


def test_a_changed_constant_is_seen_and_a_moved_line_is_not() -> None:
    code = '"""{}"""\n{}\n_A, B = 1, 2\n\n\ndef f(x):\n    """Says."""\n    return x\n'
    before, moved = code.format("Words.", "# why"), code.format("Other.", "\n\n# so")
    for entry, changed in (("a.py", "B = 1, 3"), ("a.py::f", "return x + 1")):
        old = {"a.py": "B = 1, 2", "a.py::f": "return x"}[entry]
        same, other = moved, before.replace(old, changed)
        told = [stale.hash_of([entry], lambda _, t=t: t) for t in (before, same, other)]
        assert told[0] == told[1] != told[2]
    with pytest.raises(ValueError, match=r"code.json: got 'a.py::g', expected a name"):
        stale.hash_of(["a.py::g"], lambda _: before)
