"""Runs Python as if modules were not installed, or the system had less.

`environment(modules, attributes)` is for subprocesses, and for those that they start: a
`sitecustomize` withholds what it is told of, before anything else is imported.
"""

import os
import sys
from collections.abc import Iterable
from pathlib import Path

_CUSTOM = """
import os, sys

NAMES = set(os.environ.get("WITHHELD", "").split())

def withheld(find):
    def find_spec(name, path=None, target=None):
        return None if name.partition(".")[0] in NAMES else find(name, path, target)
    return find_spec

for finder in sys.meta_path:
    finder.find_spec = withheld(finder.find_spec)
for name in NAMES & set(sys.modules):
    del sys.modules[name]
for name in os.environ.get("WITHHELD_ATTRIBUTES", "").split():
    module, _, attribute = name.partition(".")
    module = __import__(module)
    if hasattr(module, attribute):
        delattr(module, attribute)
"""


def environment(
    folder: Path, modules: Iterable[str] = (), attributes: Iterable[str] = ()
) -> dict[str, str]:
    """The environment of such a process; `folder` is for its `sitecustomize`."""
    (folder / "sitecustomize.py").write_text(_CUSTOM)
    path = os.pathsep.join([str(folder), *(p for p in sys.path if p)])
    told = {"WITHHELD": " ".join(modules), "WITHHELD_ATTRIBUTES": " ".join(attributes)}
    return {**os.environ, **told, "PYTHONPATH": path}
