"""Coverage-guided fuzzing of our own parsers of bytes and text, by hand.

`python tests/fuzz/parsers.py NAME --runs 1000000 [--keep FOLDER]`, NAME one of `TARGETS`;
needs atheris (pip install atheris), which the tests do not. A parser gives a good value or
raises a `ValueError` of one line; anything else is a finding. Each kind of finding is
told once, its input is kept in FOLDER, and the run goes on. A seeded excerpt without
coverage runs with the tests.
"""

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

import parser_files as files
import parser_seeds as seeds
import parser_targets as targets


class Target(NamedTuple):
    """A parser, the modules whose branches guide, and good inputs to begin from."""

    parse: Callable[[bytes], None]
    modules: tuple[str, ...]
    seeds: Callable[[], list[bytes]]


_WIRE = ("tomojax.hardware.sources", "cobs")
_CLI = ("tomojax.cli", "tomllib", "tomojax.files")
TARGETS = {
    "messages": Target(targets.messages, _WIRE, seeds.messages),
    "serial": Target(targets.serial, _WIRE, seeds.serial),
    "wire": Target(targets.wire, _WIRE, seeds.wire),
    "source": Target(
        targets.source,
        ("tomojax.hardware.sources",),
        lambda: [b"\0a", b"\1h:1", b"\2" + b"99"],
    ),
    "calibration": Target(
        targets.calibration,
        ("tomojax.sensor._calibration", "tomojax.files", "json"),
        seeds.calibration,
    ),
    "policy": Target(
        targets.policy, ("tomojax.step._tables", "tomojax.files"), seeds.policy
    ),
    "places": Target(
        targets.places, ("tomojax.calibration._recording", "tomojax.files"), seeds.places
    ),
    "config": Target(
        targets.config, _CLI, lambda: [b"\0" + seeds.TOML, b"\1contacts = 3\n"]
    ),
    "options": Target(targets.options, _CLI, seeds.options),
    "kinds": Target(files.kinds, ("tomojax.cli.entry", "json"), files.kinds_seeds),
    "npz": Target(files.npz, ("tomojax.files",), lambda: files.npz_seeds(seeds.arrays)),
    "superblock": Target(files.superblock, ("tomojax.files",), files.superblock_seeds),
}


class Findings:
    """Runs a parser; each place where it fails is told once."""

    def __init__(self, target: Target, keep: Path | None = None):
        self._parse, self._keep = target.parse, keep
        self.runs, self.known = 0, dict[str, bytes]()

    def __call__(self, data: bytes) -> None:
        self.runs += 1
        try:
            self._parse(data)
        except Exception as error:
            error = error.__cause__ if isinstance(error, targets.Said) else error
            assert error is not None
            frames = traceback.extract_tb(error.__traceback__)
            where = [f for f in frames if "tomojax" in f.filename] or list(frames)
            at = f"{Path(where[-1].filename).name}:{where[-1].lineno}"
            said = str(error).split()[1:2] if isinstance(error, AssertionError) else []
            kind = " ".join([f"{type(error).__name__} at {at}", *said])
            if kind not in self.known and len(self.known) < 50:
                self.known[kind] = data
                print(f"FINDING {kind}: {error!r:.300} of {data[:200]!r}", file=sys.stderr)
                if self._keep is not None:
                    self._keep.mkdir(parents=True, exist_ok=True)
                    (self._keep / f"finding-{len(self.known)}").write_bytes(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=TARGETS)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="Inputs of findings, kept here.")
    given = parser.parse_args()
    try:
        import atheris
    except ModuleNotFoundError:
        sys.exit("atheris is not installed; pip install atheris brings it (CPython ≤ 3.13)")
    os.environ["JAX_ENABLE_X64"] = "1"
    target = TARGETS[given.name]
    with atheris.instrument_imports(
        include=list(target.modules), enable_loader_override=False
    ):
        good = target.seeds()
        for seed in good:  # imports what it needs, under the instruments
            target.parse(seed)
    found = Findings(target, given.keep)
    began = time.monotonic()

    def once(data: bytes) -> None:
        found(data)
        if found.runs == given.runs:
            seconds = round(time.monotonic() - began)
            told = {"runs": found.runs, "seconds": seconds, "findings": sorted(found.known)}
            print(json.dumps({given.name: told}, indent=1))

    def other(data: bytes, most: int, seed: int) -> bytes:
        """Half of the mutations are libFuzzer's own, which coverage guides alone."""
        if seed % 2:
            return atheris.Mutate(data, most)
        return seeds.mutated([bytes(data), *good], np.random.default_rng(seed))[:most]

    corpus = Path(tempfile.mkdtemp())
    for number, seed in enumerate(good):
        (corpus / f"{number}").write_bytes(seed)
    words = f"-runs={given.runs} -seed={given.seed} -max_len=6000 -timeout=20"
    words += " -rss_limit_mb=4096 -len_control=0 -print_final_stats=1 -verbosity=1"
    atheris.Setup([sys.argv[0], *words.split(), str(corpus)], once, custom_mutator=other)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
