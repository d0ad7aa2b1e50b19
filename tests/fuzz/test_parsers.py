"""An excerpt of the fuzzer of parsers, without coverage; `parsers.py` is the whole."""

import numpy as np
import parser_seeds
import parsers
import pytest


@pytest.mark.parametrize("name", parsers.TARGETS)
def test_a_good_value_or_one_line(name):
    target, rng = parsers.TARGETS[name], np.random.default_rng(0)
    good, found = target.seeds(), parsers.Findings(target)
    for data in good:
        found(data)
    for _ in range(200):
        found(parser_seeds.mutated(good, rng))
    assert not found.known
