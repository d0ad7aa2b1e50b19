"""What pages name is there: links, headings, files, commands with options, names, flags."""

import importlib
import re
import shlex
from collections.abc import Iterator

import click
import pytest
from pages import GENERATED, Page, page, pages, ROOT, SITE, texts

import tomojax as tx
from tomojax.cli.app import app

_PATH = re.compile(
    r"(?<![\w/.~-])((?:tests|notebooks|tomojax|hardware|kernels|\.ci)/(?:[\w./\[\]*-]*[\w\]*/])?)"
)
_NAME = re.compile(r"\b(?:tx|tomojax)(?:\.[A-Za-z_]\w*)+")
_CAPITALS = re.compile(r"\b[A-Z]+(?:_[A-Z]+)+\b")
# Linux' names and environment variables; all other names of this form are flags.
_NO_FLAGS = {
    "CAP_SYS_NICE",
    "JAX_COMPILATION_CACHE_DIR",
    "PREEMPT_RT",
    "SCHED_FIFO",
    "TOMOJAX_NATIVE",
    "TOMOJAX_NO_CACHE",
    "TOMOJAX_STEPS",
    "XDG_CACHE_HOME",
}
_WRITTEN = [SITE / "reference" / name for name in GENERATED]


def shown(each: Page) -> Iterator[tuple[int, str]]:
    """Yields lines of bash, and what stands between backticks."""
    yield from each.code()
    for block in each.blocks:
        if block.language == "bash":
            yield from enumerate(block.code.splitlines(), block.line)


def links(each: Page) -> Iterator[str]:
    """Yields links that lead to no file or to no heading."""
    for line, target in each.links():
        if "://" in target or target.startswith("mailto:"):
            continue
        name, _, heading = target.partition("#")
        path = (each.path.parent / name).resolve() if name else each.path
        if not path.exists() and path not in _WRITTEN:
            yield f"{line}: no file {target}"
        elif heading and heading not in page(str(path)).anchors():
            yield f"{line}: no heading {target}"


def contents(each: Page) -> Iterator[str]:
    """Yields pages of tables of contents, cards and inclusions that are not there."""
    for line, target in each.directives():
        path = (each.path.parent / target).resolve()
        if not path.exists() and path not in _WRITTEN:
            yield f"{line}: no page {target}"


def files(each: Page) -> Iterator[str]:
    """Yields files that are not there, among those that a page names."""
    for line, text in shown(each):
        for path in _PATH.findall(text):
            # The list of tests is told from their folder.
            roots = (ROOT, each.path.parent)
            if not any(any(root.glob(path)) for root in roots):
                yield f"{line}: no file {path}"


def commands(each: Page) -> Iterator[str]:
    """Yields commands and options that `tomojax` has not."""
    for line, text in shown(each):
        for words in re.findall(r"(?:^|(?<=/)|(?<=&& ))tomojax ([^|&;<>]+)", text):
            if told := unknown(shlex.split(words.strip())):
                yield f"{line}: tomojax {words.strip()}: no {told}"


def unknown(words: list[str]) -> str:
    """Returns the first word of a line that `tomojax` does not know, or none."""
    name = next((word for word in words if not word.startswith("-")), "")
    options = {"--help", "--version"} | options_of(app)
    if name in app.commands:
        options |= options_of(app.commands[name])
    elif name and name != "COMMAND":
        return name
    asked = (word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word))
    return next((word for word in asked if word not in options), "")


def options_of(command: click.Command) -> set[str]:
    return {one for p in command.params for one in (*p.opts, *p.secondary_opts)}


def options(each: Page) -> Iterator[str]:
    """Yields options, named without their command, that no command has."""
    known = set().union(*(options_of(one) for one in (app, *app.commands.values())))
    for line, text in each.code():
        if text.startswith("--"):
            words = re.findall(r"--[a-z][\w-]*", text)
            yield from (f"{line}: no {word}" for word in words if word not in known)


def scripts(each: Page) -> Iterator[str]:
    """Yields scripts that are not there, and options that they do not take."""
    for line, text in shown(each):
        for name, words in re.findall(r"python (tests/\S+\.py)([^|&;<>]*)", text):
            path = ROOT / name
            code = path.read_text() if path.is_file() else ""
            asked = re.findall(r"--[a-z][\w-]*", words)
            missing = [one for one in asked if f'"{one}"' not in code]
            yield from (f"{line}: {name} has no {one}" for one in missing)


def names(each: Page) -> Iterator[str]:
    """Yields names of the package that lead to nothing."""
    told = [(line, found[0]) for line, text in each.code() if (found := _NAME.match(text))]
    for block in (one for one in each.blocks if one.language == "python"):
        for line, text in enumerate(block.code.splitlines(), block.line):
            told += [(line, found[0]) for found in _NAME.finditer(text)]
    yield from (f"{line}: no {name}" for line, name in told if not resolved(name))


def resolved(name: str) -> bool:
    first, *others = name.split(".")
    thing = tx if first == "tx" else importlib.import_module(first)
    for other in others:
        if not hasattr(thing, other):
            try:
                importlib.import_module(f"{thing.__name__}.{other}")
            except (AttributeError, ImportError):
                return False
        thing = getattr(thing, other)
    return True


def flags(each: Page) -> Iterator[str]:
    """Yields words that look like a flag, and are none."""
    known = {*tx.Flag.__members__, *type(tx.Flag(1).level).__members__, *_NO_FLAGS}
    for line, text in each.plain:
        words = _CAPITALS.findall(text)
        yield from (f"{line}: no flag {word}" for word in words if word not in known)


@pytest.mark.parametrize(
    "wrong", [links, contents, files, commands, options, scripts, names, flags]
)
def test_what_pages_name_is_there(wrong) -> None:
    assert not [f"{each.name}:{told}" for each in texts() for told in wrong(each)]


def test_all_pages_are_looked_at() -> None:
    assert len(pages()) > 45 and {"README.md", "hardware/PROTOCOL.md"} < set(pages())
    assert sum(len(list(each.links())) for each in texts()) > 200
    told = [words for each in texts() for _, words in shown(each)]
    assert sum(words.startswith("tomojax ") for words in told) > 100
    assert sum(words.startswith("python tests/") for words in told) > 40


def test_every_page_of_the_site_is_in_a_table_of_contents() -> None:
    told = {
        (each.path.parent / target).resolve()
        for each in texts()
        for _, target in each.directives()
    }
    own = [each.path for each in texts() if SITE in each.path.parents]
    assert not [p for p in own if p not in told and p != SITE / "index.md"]


def test_contributing_names_places() -> None:
    lines = [text for _, text in page("CONTRIBUTING.md").plain if text.startswith("|")]
    assert len(lines) >= 9
    for row in lines[2:]:
        assert _PATH.findall(row), row


def test_a_mistake_is_seen(tmp_path) -> None:
    """Each check, on a page where all is wrong."""
    path = tmp_path / "page.md"
    path.write_text(
        "[a](none.md), [b](#none), `tests/none.py`, `tomojax none`, `tomojax info --none`\n"
        "`--none`, `python tests/words.py --none`, `tx.none`, NO_FLAG\n"
        "\n```{toctree}\nnone\n```\n"
    )
    wrong = Page(str(path))
    counted = [len(list(check(wrong))) for check in (links, contents, files, commands)]
    counted += [len(list(check(wrong))) for check in (options, scripts, names, flags)]
    assert counted == [2, 1, 1, 2, 1, 1, 1, 1]
