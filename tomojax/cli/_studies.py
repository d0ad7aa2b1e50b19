"""`tomojax frontier` and `stability`: a checkout has their code, the wheel does not."""

import importlib
import sys
from pathlib import Path

import click

_BENCHMARKS = Path(__file__).parents[2] / "tests" / "benchmarks"


def _without_checkout(name: str) -> click.Command:
    def refuse() -> None:
        raise ValueError(f"{name} needs a checkout of the repository")

    anything = {"ignore_unknown_options": True, "allow_extra_args": True}
    told = "Run a study of the methods (in a checkout of the repository)."
    return click.Command(name, context_settings=anything, callback=refuse, help=told)


def studies() -> tuple[click.Command, ...]:
    """Returns the two commands; without a checkout they say that they need one."""
    names = ("frontier", "stability")
    if not (_BENCHMARKS / "bench").is_dir():
        return tuple(_without_checkout(name) for name in names)
    sys.path.append(str(_BENCHMARKS))
    cli = importlib.import_module("bench.cli")
    return tuple(getattr(cli, name) for name in names)
