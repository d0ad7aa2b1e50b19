"""Examples of the rooms that judge a rig and calibrate it."""

import docstrings
import pytest


@pytest.mark.parametrize("example", docstrings.share("calibration"))
def test_example(example, tmp_path) -> None:
    docstrings.run(example, tmp_path)
