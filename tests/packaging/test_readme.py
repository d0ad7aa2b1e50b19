"""README's Python is Python, of names and arguments that there are."""

import ast
import inspect
import operator
import re
from pathlib import Path

import pytest

import tomojax as tx

README = Path(__file__).parents[2] / "README.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.M | re.S)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_names_and_arguments(block):
    calls = [node for node in ast.walk(ast.parse(block)) if isinstance(node, ast.Call)]
    named = [(call, ast.unparse(call.func)) for call in calls]
    ours = [(call, name[3:]) for call, name in named if re.fullmatch(r"tx[.\w]+", name)]
    if not ours:  # a class of the reader's own: it can be defined
        assert "from tomojax" in block
        exec(block, {"__name__": "readme"})
    for call, name in ours:
        signature = inspect.signature(operator.attrgetter(name)(tx))
        signature.bind(*call.args, **{k.arg: k.value for k in call.keywords})
