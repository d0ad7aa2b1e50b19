"""Counts sentences that are hard to read: over 24 words, or a subject hung behind a clause.

    python tests/words.py [FILE ...]      # names each; by default all that people read

Sentences come from docstrings, the help of options, and pages. Code, tables and headings
do not count, nor do questions. A sentence is hung where it opens with Of, As, With, What
or Where.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
MOST = 24  # words of a sentence
OPENINGS = {"Of", "As", "With", "What", "Where"}
FOLDERS = ("tomojax", "kernels", "hardware", "notebooks", "tests/benchmarks/bench")
PAGES = ("README.md", "CONTRIBUTING.md")
_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
_FENCE = re.compile(r"^(`{3,}|:{3,}).*?^\1$", re.M | re.S)
_END = re.compile(r"(?<=[.!?:;])\s+(?=[A-Z\[\"“(*`]|code|tomojax)")


class Sentence(NamedTuple):
    """A sentence, where it stands, and what is wrong with it ("" where nothing is)."""

    path: Path
    line: int
    text: str
    fault: str


def sentences(path: Path) -> Iterator[Sentence]:
    """Yields the sentences of a page or of a file of Python."""
    text = path.read_text()
    if path.suffix == ".md":
        parts = [(1, text)]
    else:
        parts = list(_texts(ast.parse(text)))
        if path.parent.name == "notebooks":
            lines = (n[2:] if n.startswith("# ") else "" for n in text.splitlines())
            parts.append((1, "\n".join(lines)))
    for line, part in parts:
        for sentence in _split(part, path.suffix == ".md"):
            yield Sentence(path, line, sentence, _fault(sentence))


def _texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yields docstrings and texts of `help=`."""
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and (text := ast.get_docstring(node)):
            yield node.body[0].lineno, text
        elif isinstance(node, ast.keyword) and node.arg in ("help", "epilog"):
            held = getattr(node.value, "values", [node.value])
            words = (getattr(one, "value", "X") for one in held)
            yield node.value.lineno, "".join(w for w in words if isinstance(w, str))


def _split(text: str, page: bool) -> Iterator[str]:
    kept = []
    for line in _FENCE.sub("", text).splitlines():
        bare = line.strip()
        # A page's lines that stand four in are code as well.
        code = page and line.startswith("    ")
        if code or bare.startswith((">>>", "...", "|", "!", "#", "$$", "---")):
            kept.append("")
        else:
            kept.append(re.sub(r"^([-*] |\d+\. |: )", "\n", bare))
    for paragraph in re.split(r"\n\s*\n|\n(?=\n)", "\n".join(kept)):
        plain = re.sub(r"\]\([^)]*\)|\{\w+\}", "]", paragraph)
        plain = " ".join(re.sub(r"`[^`]*`", "code", plain).split())
        plain = re.sub(r"^\*\*\w+:\*\*\s*", "", plain)
        yield from (one for one in _END.split(plain) if len(one.split()) > 2)


def _fault(sentence: str) -> str:
    words = [word for word in sentence.split() if re.search(r"\w", word)]
    if len(words) > MOST:
        return f"{len(words)} words"
    opening = words[0].strip('*_("') if words else ""
    hung = opening in OPENINGS and not sentence.endswith("?")
    return f"opens with {opening}" if hung else ""


def everything() -> list[Sentence]:
    """Returns all sentences of the project that people read."""
    paths = [ROOT / name for name in PAGES]
    for folder in FOLDERS:
        paths += sorted((ROOT / folder).rglob("*.md")) + sorted(
            (ROOT / folder).rglob("*.py")
        )
    generated = ROOT / "notebooks" / "reference" / "api"
    return [s for p in paths if generated not in p.parents for s in sentences(p)]


def main() -> None:
    given = [s for name in sys.argv[1:] for s in sentences(Path(name))]
    found = given or everything()
    for one in found:
        if one.fault:
            print(f"{one.path}:{one.line}: {one.fault}: {one.text[:150]}")
    wrong = sum(bool(one.fault) for one in found)
    print(f"{wrong} of {len(found)} sentences, {100 * wrong / max(1, len(found)):.1f} %")


if __name__ == "__main__":
    main()
