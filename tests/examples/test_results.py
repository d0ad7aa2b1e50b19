"""Examples of the rooms from recordings to results, exports and steps."""

import docstrings
import pytest


@pytest.mark.parametrize("example", docstrings.share("results"))
def test_example(example, tmp_path) -> None:
    docstrings.run(example, tmp_path)
