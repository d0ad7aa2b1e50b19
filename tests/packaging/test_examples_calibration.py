"""Examples of the rooms that judge a rig and calibrate it."""

import examples
import pytest


@pytest.mark.parametrize("example", examples.share("test_examples_calibration"))
def test_example(example, tmp_path) -> None:
    examples.run(example, tmp_path)
