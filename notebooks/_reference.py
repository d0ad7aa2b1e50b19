"""Writes the reference from the code: public names by room, commands, flags.

The pages lie in `reference/` and are not committed: `conf.py` calls `write` before Sphinx
looks for pages. A docstring is Markdown; its doctest becomes a block of code.
"""

import importlib
import inspect
import pkgutil
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, get_origin

# Rooms in the order in which a reader needs them, with what each is for.
ROOMS = {
    "tomojax": "the face",
    "tomojax.sensor": "the rig and what touches it; exact voltages",
    "tomojax.paper": "ground patterns, Eq. 3, figures of merit",
    "tomojax.methods": "the ladder of models",
    "tomojax.step": "one slot in, contacts and the next ground out",
    "tomojax.native": "JAX functions written as C",
    "tomojax.recordings": "files of measured scans",
    "tomojax.ert": "current between pairs of electrodes, on a sheet that changes",
    "tomojax.results": "recordings to results, tracks, reports, plots",
    "tomojax.calibration": "a rig's true values",
    "tomojax.bringup": "faults of a new rig",
    "tomojax.bringup.signs": "signs of wrong wiring in any recording",
    "tomojax.design": "ground sets, λ, electrodes",
    "tomojax.events": "touch-down, lift-off, marks",
    "tomojax.exports": "results for other programs",
    "tomojax.plots": "drawing on your own axes",
    "tomojax.hardware": "the live loop",
    "tomojax.hardware.sources": "where slots come from",
    "tomojax.hardware.sinks": "where contacts go",
    "tomojax.hardware.loop": "the loop, its ring and the real-time settings",
    "tomojax.hardware.loop.in_c": "the loop's ordinary way, in C",
    "tomojax.kernels.rectangle": "the rectangle's Green's function, with NumPy or JAX",
    "tomojax.kernels.sheet": "the sheet's physics, arrays in, arrays out",
    "tomojax.kernels.inverse": "Eq. 3, bases, rules for λ",
    "tomojax.kernels.contacts": "contacts fitted to voltages",
    "tomojax.kernels.images": "contacts read off images",
    "tomojax.kernels.scan": "the adaptive scan",
    "tomojax.kernels.shapes": "two-level fields",
    "tomojax.kernels.algebra": "solves and filters without physics",
}


def rooms() -> Iterator[ModuleType]:
    """Yields the rooms that exist."""
    for name in ROOMS:
        parent, _, last = name.rpartition(".")
        if parent and not any(
            m.name == last
            for m in pkgutil.iter_modules(importlib.import_module(parent).__path__)
        ):
            continue
        yield importlib.import_module(name)


def public(room: ModuleType) -> Iterator[tuple[str, Any]]:
    """Yields the names that a room offers; rooms inside it have pages of their own."""
    told = getattr(room, "__all__", None)
    for name in told or [name for name in vars(room) if not name.startswith("_")]:
        thing = getattr(room, name)
        module = getattr(thing, "__module__", None) or room.__name__
        # Types that are put together, such as a Literal, say that they are of `typing`.
        if not inspect.ismodule(thing) and (told or str(module).startswith("tomojax")):
            yield name, thing


def _fenced(text: str) -> str:
    """A docstring with its doctest in a fence."""
    lines, inside = [], False
    for line in text.splitlines():
        code = line.startswith((">>>", "...")) or (inside and bool(line.strip()))
        if code != inside:
            lines.append("```pycon" if code else "```")
        lines.append(line)
        inside = code
    return "\n".join([*lines, "```"] if inside else lines)


def _signature(thing: Any) -> str:
    try:
        told = inspect.signature(thing)
    except (TypeError, ValueError):
        return ""
    bare = [
        p.replace(annotation=inspect.Parameter.empty)
        for p in told.parameters.values()
        if p.name != "self"
    ]
    plain = told.replace(parameters=bare, return_annotation=inspect.Signature.empty)
    # Defaults that have no short text (arrays, sentinels) are told in words.
    return re.sub(r"=<[^>]*>|=[^,()]{40,}", "=…", str(plain))


def _members(thing: type) -> Iterator[str]:
    """Yields directives of a class's public methods and properties.

    Its own, and those of what it is made of that its room does not offer.
    """
    place = thing.__module__.rpartition(".")[0]
    offered = vars(sys.modules[place])
    parts = [
        part
        for part in thing.__mro__
        if part is thing
        or (part.__module__.rpartition(".")[0] == place and part.__name__ not in offered)
    ]
    for name, member in (pair for part in parts for pair in vars(part).items()):
        if name.startswith("_"):
            continue
        bare = member.fget if isinstance(member, property) else member
        bare = getattr(bare, "__func__", bare)
        bare = inspect.unwrap(bare) if callable(bare) else bare
        if not inspect.isfunction(bare) or not inspect.getdoc(bare):
            continue
        kind = "property" if isinstance(member, property) else "method"
        told = "" if kind == "property" else _signature(bare)
        text = _fenced(inspect.getdoc(bare) or "")
        yield f"::::{{py:{kind}}} {name}{told}\n:no-index:\n\n{text}\n::::"


def _described(name: str, thing: Any) -> str:
    text = inspect.getdoc(thing) or ""
    if inspect.isclass(thing):
        text = "\n\n".join([_fenced(text), *_members(thing)])
        return f":::::{{py:class}} {name}{_signature(thing)}\n\n{text}\n:::::"
    if callable(thing) and get_origin(thing) is None:
        told = _signature(thing)
        return f":::::{{py:function}} {name}{told}\n\n{_fenced(text)}\n:::::"
    shown = repr(thing).removeprefix("typing.")
    shown = shown if len(shown) < 200 else f"{type(thing).__name__} of {len(thing)}"
    return f":::::{{py:data}} {name}\n\n`{shown}`\n:::::"


def room_page(room: ModuleType) -> str:
    """Returns a room's page: what the room is for, then each of its names."""
    name = room.__name__
    parts = [f"# {name}", f"```{{py:currentmodule}} {name}\n```"]
    parts += [inspect.getdoc(room) or ""]
    parts += [_described(one, thing) for one, thing in public(room)]
    return "\n\n".join(parts) + "\n"


def flags_page() -> str:
    """Returns the table of flags."""
    from tomojax import Flag

    lines = [
        "# Flags",
        "Each row of results has a number `flags`, a sum of the bits below. "
        "[Read the flags](../how/flags.md) says how to use them.",
        "| flag | bit | level | what was seen | what to do |\n|---|---|---|---|---|",
    ]
    rows = [
        f"| `{f.name}` | {f.value} | {f.level.name.lower().replace('_', ' ')} "
        f"| {f.meaning} | {f.advice} |"
        for f in Flag
    ]
    return "\n\n".join(lines) + "\n" + "\n".join(rows) + "\n"


def commands_page() -> str:
    """Returns the page of commands, which sphinx-click fills from their help."""
    return (
        "# Commands\n\nEach command prints this text with `--help`.\n\n```{eval-rst}\n"
        ".. click:: tomojax.cli.app:app\n   :prog: tomojax\n   :nested: full\n```\n"
    )


def write(folder: Path) -> None:
    """Writes the generated pages into `folder`, and only what has changed."""
    pages = {
        f"api/{room.__name__.removeprefix('tomojax.')}.md": room_page(room)
        for room in rooms()
    }
    toc = "\n".join(f"api/{name.removeprefix('tomojax.')}" for name in ROOMS)
    table = "\n".join(
        f"| [`{room.__name__}`](api/{room.__name__.removeprefix('tomojax.')}.md) "
        f"| {ROOMS[room.__name__]} |"
        for room in rooms()
    )
    there = {f"api/{room.__name__.removeprefix('tomojax.')}" for room in rooms()}
    toc = "\n".join(line for line in toc.splitlines() if line in there)
    pages["python.md"] = (
        "# Python\n\nEvery public name, by room.\n\n| room | for |\n|---|---|\n"
        f"{table}\n\n```{{toctree}}\n:hidden:\n\n{toc}\n```\n"
    )
    pages |= {"flags.md": flags_page(), "commands.md": commands_page()}
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)
