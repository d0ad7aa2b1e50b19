"""Examples of the room that designs ground sets."""

import examples
import pytest


@pytest.mark.parametrize("example", examples.share("test_examples_design"))
def test_example(example, tmp_path) -> None:
    examples.run(example, tmp_path)
