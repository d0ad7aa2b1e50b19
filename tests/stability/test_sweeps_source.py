"""`source`: its stated limits, and what it says beyond them."""

import pytest
from sweeps import check, stated, swept

from bench.stability import SWEEPS


@pytest.mark.parametrize("name", swept("source"))
def test_source(name):
    check("source", name)


def test_every_sweep_is_stated():
    assert stated("source") == [
        name for name, sweep in SWEEPS.items() if not sweep.only or "source" in sweep.only
    ]
