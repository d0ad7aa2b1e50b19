"""Sentences that people read are short and begin with their subject."""

from pathlib import Path

import words


def test_nearly_all_sentences_are_plain() -> None:
    found = words.everything()
    wrong = [f"{s.path.name}:{s.line}: {s.fault}" for s in found if s.fault]
    assert len(found) > 3000
    assert len(wrong) <= 0.02 * len(found), wrong


def test_the_counter_sees_what_it_is_for(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A title of words\n\nOf each scan its slots alone.\n\nIt is fine.\n")
    assert [s.fault for s in words.sentences(page)] == ["opens with Of", ""]
    page.write_text("`x` is " + "very " * 23 + "long.\n\n| Of | With |\n")
    assert [s.fault for s in words.sentences(page)] == ["26 words"]
