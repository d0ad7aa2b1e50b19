"""Examples of the room that designs ground sets."""

import docstrings
import pytest


@pytest.mark.parametrize("example", docstrings.share("design"))
def test_example(example, tmp_path) -> None:
    docstrings.run(example, tmp_path)
