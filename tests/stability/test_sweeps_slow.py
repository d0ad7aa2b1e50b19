"""`auto`: some of its stated limits, and what it says beyond."""

import pytest
from sweeps import check

from bench.stability import CONTACTS, SLOW_TESTS


@pytest.mark.long
@pytest.mark.parametrize("name", SLOW_TESTS)
def test_auto(name):
    check("auto", name)


def test_more_contacts_than_are_looked_for():
    assert CONTACTS == 3
