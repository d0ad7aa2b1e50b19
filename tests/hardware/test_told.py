"""What is said of a loop: its load, its latency and its flags, in sentences."""

import numpy as np
import pytest

import tomojax as tx
from tomojax.hardware import Got, SlotRing
from tomojax.hardware.loop import answered, flags_text, latency_text, load_text
from tomojax.hardware.loop.view import lines

GAP = int(tx.Flag.GAP)


@pytest.fixture
def ring(tmp_path):
    return SlotRing.create(4, 1, length=64, folder=tmp_path)


def put(ring, count, latency=2e-4, flags=0):
    for k in range(count):
        said = {"latency": latency, "next": 0, "flags": flags, "count": 0}
        ring.put(Got(0, 0, k, 1e-3 * k, 0.0), np.zeros(4, np.int16), said)
        if np.isfinite(latency):
            ring.head["latency"][min(int(1e6 * latency), 19_999)] += 1


def shown(ring, explained=()):
    last = ring.rows[(int(ring.head["rows"]) - 1) % ring.length].copy()
    return lines(ring, last, 1000.0, set(explained))


def test_overload_is_told_as_a_part_and_with_what_to_do(ring):
    put(ring, 20)
    ring.count(slots=100, skipped=80)
    assert answered(ring) == 0.2
    text = load_text(ring)
    assert "answers 20 % of the slots" in text and "fewer --contacts" in text
    assert text in shown(ring)
    ring.count(skipped=1)
    assert load_text(ring) == "answers 95 % of the slots"


def test_what_takes_longest_is_no_number_of_the_histogram(ring):
    put(ring, 2, latency=5.0)
    assert latency_text(ring, 0.5, 0.99).endswith("20000 or more, 20000 or more µs")


def test_nothing_is_said_of_a_latency_that_nobody_measured(ring):
    put(ring, 3, latency=np.nan)
    assert latency_text(ring, 0.5) == load_text(ring) == "" and flags_text(ring) == []
    assert not any("nan" in line or "ground command" in line for line in shown(ring))


def test_flags_are_explained_once(ring):
    put(ring, 6)
    put(ring, 2, flags=GAP)
    (text,) = flags_text(ring)
    assert text.startswith("in 25 % of the last slots GAP: Scans or slots were lost")
    told = [line for line in shown(ring) if line.startswith("GAP: ")]
    assert told == [f"GAP: {tx.Flag.GAP.explanation}"]
    again = shown(ring, {tx.Flag.GAP})
    assert any("GAP" in line for line in again)
    assert not any(line.startswith("GAP: ") for line in again)
