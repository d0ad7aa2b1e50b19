"""`linear`: its stated limits, and what it says beyond them."""

import pytest
from sweeps import check, stated, swept

from bench.stability import SWEEPS


@pytest.mark.parametrize("name", swept("linear"))
def test_linear(name):
    check("linear", name)


def test_every_sweep_is_stated():
    assert stated("linear") == [
        name for name, sweep in SWEEPS.items() if not sweep.only or "linear" in sweep.only
    ]
