"""What people read, taken apart: blocks, headings, links and code within a line.

A block of a page is marked by a comment in the line above it:

    <!-- long: it searches for a minute -->

Such a block runs with `pytest -m "long or not long"`, and the others always.
"""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
SITE = ROOT / "notebooks"
# Sphinx shows these as Python of its own: `.ci/run` runs them as it builds the site.
NOTEBOOKS = sorted(set(SITE.rglob("*.py")) - {SITE / "conf.py", SITE / "_reference.py"})
# Written from the code, and not committed.
GENERATED = ("api", "commands.md", "flags.md", "python.md")

_FENCE = re.compile(r"(`{3,}|:{3,})(.*)")
_LONG = re.compile(r"<!-- long: (.+) -->")
_HEADING = re.compile(r"#{1,6} (.+)")
_LINK = re.compile(r"\]\(([^()\s]+)\)")
_CODE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
# What opens a virtual environment or fills one: `.ci/run` runs README's.
_INSTALLS = ("python3 -m venv ", ". .venv/bin/activate")


class Block(NamedTuple):
    """A block of code: `line` is its first one's number, `long` why it takes long."""

    page: str
    line: int
    language: str
    code: str
    long: str

    @property
    def installs(self) -> bool:
        return all(one.startswith(_INSTALLS) for one in self.code.splitlines())


class Said(NamedTuple):
    """A piece of a page, and the number of its line."""

    line: int
    text: str


class Page:
    """A page by its path from the checkout's root."""

    def __init__(self, name: str):
        self.name, self.path = name, ROOT / name
        text = self.path.read_text()
        if self.path.suffix == ".py":  # a notebook: its text stands in comments
            lines = (one.removeprefix("#").removeprefix(" ") for one in text.splitlines())
            told = (one.startswith("#") for one in text.splitlines())
            text = "\n".join(one if says else "" for one, says in zip(lines, told))
        self.lines = text.splitlines()
        self.blocks: list[Block] = []
        self.plain: list[Said] = []  # lines outside blocks
        self._take_apart()

    def _take_apart(self) -> None:
        fence, language, begun, above = "", "", 0, ""
        for number, line in enumerate(self.lines, 1):
            bare = line.strip()
            found = _FENCE.fullmatch(bare)
            if fence and bare == fence:
                code = "\n".join(self.lines[begun : number - 1]) + "\n"
                long = _LONG.fullmatch(above)
                reason = long[1] if long else ""
                self.blocks.append(Block(self.name, begun + 1, language, code, reason))
                fence = ""
            elif not fence and found and found[1].startswith("`"):
                fence, language, begun = found[1], found[2].strip(), number
                above = self.lines[number - 2].strip() if number > 1 else ""
            elif not fence:
                self.plain.append(Said(number, line))

    def code(self) -> Iterator[Said]:
        """Yields what stands between backticks; a line may end within."""
        text = "\n".join(line for _, line in self.plain)
        for found in _CODE.finditer(text):
            line = self.plain[text.count("\n", 0, found.start())].line
            yield Said(line, " ".join(found[1].split()))

    def links(self) -> Iterator[Said]:
        """Yields the targets of links and pictures."""
        for line, text in self.plain:
            for found in _LINK.finditer(_CODE.sub("code", text)):
                yield Said(line, found[1])

    def directives(self) -> Iterator[Said]:
        """Yields files and pages that directives of MyST name."""
        for block in self.blocks:
            kind, _, told = block.language.partition(" ")
            if kind in ("{include}", "{literalinclude}"):
                yield Said(block.line, told.strip())
            elif kind == "{toctree}":
                words = (one.strip() for one in block.code.splitlines())
                for word in (w for w in words if w and not w.startswith(":")):
                    yield Said(block.line, _page_of(self.path.parent, word))
        for line, text in self.plain:
            if text.startswith(":link: "):
                yield Said(line, _page_of(self.path.parent, text.split()[1]))

    def anchors(self) -> set[str]:
        """Returns the headings as links name them."""
        found = (_HEADING.fullmatch(line) for _, line in self.plain)
        return {anchor(heading[1]) for heading in found if heading}


def anchor(heading: str) -> str:
    """Returns a heading as GitHub and MyST name it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _page_of(folder: Path, name: str) -> str:
    """Returns a page with its ending, which a toctree leaves out, or of `Title <page>`."""
    titled = re.fullmatch(r".*<(\S+)>", name)
    name = titled[1] if titled else name
    notebook = (folder / f"{name}.py").is_file()
    return f"{name}.py" if notebook else f"{name}.md"


def _generated(path: Path) -> bool:
    reference = SITE / "reference"
    return path.parent in (reference, reference / "api") and (
        path.parent.name == "api" or path.name in GENERATED
    )


@cache
def page(name: str) -> Page:
    return Page(name)


@cache
def pages() -> tuple[str, ...]:
    """Returns the pages that people write: README, CONTRIBUTING, the site, folders' own."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    found += sorted(path for path in SITE.rglob("*.md") if not _generated(path))
    for folder in ("hardware", "tomojax", "tests"):
        found += sorted((ROOT / folder).rglob("*.md"))
    return tuple(str(path.relative_to(ROOT)) for path in found)


@cache
def texts() -> tuple[Page, ...]:
    """Returns all pages and notebooks."""
    notebooks = (str(path.relative_to(ROOT)) for path in NOTEBOOKS)
    return tuple(page(name) for name in (*pages(), *notebooks))
