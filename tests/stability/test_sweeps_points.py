"""`points`: its stated limits, and what it says beyond them."""

import pytest
from sweeps import check, stated, swept

from bench.stability import SWEEPS


@pytest.mark.parametrize("name", swept("points"))
def test_points(name):
    check("points", name)


def test_every_sweep_is_stated():
    assert stated("points") == [
        name for name, sweep in SWEEPS.items() if not sweep.only or "points" in sweep.only
    ]
