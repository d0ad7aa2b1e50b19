"""Every block of code that people are shown runs, as a user runs it, in the page's order.

Python runs in one module a page, commands run in this process, and other lines in bash.
Blocks that are marked long are compiled here, and run where long tests do. What installs
tomojax is not run: `.ci/run` begins with README's line.
"""

import os
import re
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import jax
import pytest
from matplotlib import pyplot as plt
from pages import Block, page, pages, ROOT, texts

from tomojax.cli import app
from tomojax.methods import METHODS

LANGUAGES = ("python", "bash")
BLOCKS = {
    name: [block for block in page(name).blocks if block.language in LANGUAGES]
    for name in pages()
}
RUN = [name for name, blocks in BLOCKS.items() if any(not one.installs for one in blocks)]
LONG = [name for name in RUN if any(block.long for block in BLOCKS[name])]

# Pages whose blocks compile many programs; in the short run they are compiled as Python.
SLOW = [
    f"notebooks/how/{name}.md"
    for name in (
        *("measured_skins", "skins", "arrays", "method", "machines", "files"),
        *("c_library", "draw", "grounds"),
    )
]

# A command, and what bash makes of its status.
_COMMAND = re.compile(r"tomojax ([^|&;<>]*)(.*)")


@pytest.fixture
def user(tmp_path, monkeypatch) -> Iterator[None]:
    """A user's folder and JAX's own settings, also in threads; no right to SCHED_FIFO."""
    monkeypatch.chdir(tmp_path)
    before = jax.config.jax_enable_x64, jax.config.jax_numpy_dtype_promotion  # pyright: ignore
    jax.config.update("jax_enable_x64", False)
    jax.config.update("jax_numpy_dtype_promotion", "standard")

    def forbidden(*_: object) -> None:
        raise PermissionError

    # Else it stops all other work of the machine, where tests run as root.
    monkeypatch.setattr(os, "sched_setscheduler", forbidden, raising=False)
    methods = dict(METHODS)
    yield
    METHODS.clear()
    METHODS.update(methods)
    plt.close("all")
    jax.config.update("jax_enable_x64", before[0])
    jax.config.update("jax_numpy_dtype_promotion", before[1])


def compiled(block: Block):
    """The code, whose lines have the page's numbers."""
    path = str(ROOT / block.page)
    return compile("\n" * (block.line - 1) + block.code, path, "exec")


def run_python(block: Block, module: ModuleType) -> None:
    exec(compiled(block), vars(module))


def run_bash(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    for line in block.code.replace("\\\n", " ").splitlines():
        where = f"{block.page}:{block.line}: {line}"
        command = _COMMAND.fullmatch(line)
        if command:
            status = run_command(command[1], monkeypatch)
            assert command[2][:2] in ("", "||", "&&"), f"{where}: a pipe is not run"
            line = f"(exit {status}) {command[2]}"
        assert subprocess.run(["bash", "-ec", line]).returncode == 0, where


def run_command(words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """The exit status of a command that runs in this process."""
    monkeypatch.setattr(sys, "argv", ["tomojax", *split(words)])
    with pytest.raises(SystemExit) as stop:
        app.run()
    return int(stop.value.code or 0)


def split(words: str) -> list[str]:
    return [one.strip("\"'") for one in re.findall(r"\"[^\"]*\"|'[^']*'|\S+", words)]


def run_blocks(blocks: list[Block], monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("page_that_runs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for block in blocks:
        if block.installs:
            continue
        if block.language == "python":
            run_python(block, module)
        else:
            run_bash(block, monkeypatch)
    # What a block that is left out here would have closed.
    for thing in vars(module).values():
        if isinstance(thing, socket.socket):
            thing.close()


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.long) if n in SLOW else n for n in RUN],
)
def test_blocks_run(name, user, monkeypatch) -> None:
    run_blocks([block for block in BLOCKS[name] if not block.long], monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("name", LONG)
def test_blocks_that_take_long_run(name, user, monkeypatch) -> None:
    run_blocks(BLOCKS[name], monkeypatch)


def test_all_blocks_are_of_a_kind_that_is_looked_at() -> None:
    shown = ("text", *LANGUAGES)  # `text` is a picture or a file
    wrong = [
        f"{block.page}:{block.line}: a block of {block.language!r}"
        for each in texts()
        for block in each.blocks
        if block.language not in shown and not block.language.startswith("{")
    ]
    assert not wrong
    found = [block for blocks in BLOCKS.values() for block in blocks]
    assert len(found) > 70
    for block in found:
        if block.language == "python":
            compiled(block)
    # README and the first page install tomojax, and README says how the tests run.
    assert [block.page for block in found if block.installs] == [
        "README.md",
        "README.md",
        "notebooks/start.md",
    ]


def test_what_is_installed_has_a_name() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = extras["project"]["optional-dependencies"]
    told = [
        (f"{each.name}:{said.line}", extra)
        for each in texts()
        for said in each.plain
        for brackets in re.findall(r"(?:tomojax|'\.)\[([\w,]+)\]", said.text)
        for extra in brackets.split(",")
    ]
    told += [
        (f"{block.page}:{block.line}", extra)
        for blocks in BLOCKS.values()
        for block in blocks
        for brackets in re.findall(r"install .*\.\[([\w,]+)\]", block.code)
        for extra in brackets.split(",")
    ]
    assert len(told) > 5
    assert not [each for each in told if each[1] not in extras]


def test_readme_is_short_and_its_example_has_ten_lines() -> None:
    text = Path(ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 97
    (heading,) = (s.line for s in page("README.md").plain if "in ten lines" in s.text)
    example = next(block for block in BLOCKS["README.md"] if block.line > heading)
    assert len([line for line in example.code.splitlines() if line.strip()]) == 10
