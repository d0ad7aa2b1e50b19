"""Examples of the rooms from recordings to results, exports and steps."""

import examples
import pytest


@pytest.mark.parametrize("example", examples.share("test_examples_results"))
def test_example(example, tmp_path) -> None:
    examples.run(example, tmp_path)
