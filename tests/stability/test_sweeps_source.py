"""`source`: its stated limits, and what it says beyond them."""

import pytest
from sweeps import check, stated

from bench.stability import SWEEPS


@pytest.mark.parametrize("name", stated("source"))
def test_source(name):
    check("source", name)


def test_every_sweep_is_stated():
    assert stated("source") == [
        name for name, sweep in SWEEPS.items() if not sweep.only or "source" in sweep.only
    ]
