"""`conductance` and `auto`: some of their stated limits, and what they say beyond."""

import pytest
from sweeps import check

from bench.stability import CONTACTS, SLOW_TESTS


@pytest.mark.parametrize("name", SLOW_TESTS)
def test_conductance(name):
    check("conductance", name)


@pytest.mark.parametrize("name", SLOW_TESTS)
def test_auto(name):
    check("auto", name)


def test_more_contacts_than_are_looked_for():
    assert CONTACTS == 3
