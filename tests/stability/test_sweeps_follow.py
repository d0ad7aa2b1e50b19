"""`follow`: its stated limits, and what it says beyond them."""

import pytest
from sweeps import check, scenes, stated, swept

from bench.stability import SWEEPS, takes_part


@pytest.mark.long
@pytest.mark.parametrize("name", swept("follow"))
def test_follow(name):
    check("follow", name)


@pytest.mark.long
def test_every_sweep_is_stated():
    """A sweep that `follow` has no part in is one that takes_part leaves out."""
    for name in SWEEPS.keys() - stated("follow"):
        sweep = SWEEPS[name]
        assert not takes_part(sweep, "follow", scenes(name, sweep.values[0])), name
