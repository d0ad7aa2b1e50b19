"""The NI source's own: what it asks of a device, and what it makes of its answers."""

import numpy as np
import pytest
from ni import Device
from nidaqmx import utils

from tomojax.hardware import open_source
from tomojax.hardware.sources.ni import NiSource, word_of


@pytest.fixture
def device(scene, monkeypatch):
    made = Device(np.load(scene)["voltages"][0])
    monkeypatch.setattr(utils, "_select_interpreter", lambda *_: made)
    return made


def read(source, count):
    codes, found = np.zeros(64, np.int16), []
    while len(found) < count:
        got = source.read(codes, 1.0)
        if got is not None:
            found.append((got, codes * source.scale))
    return found


@pytest.mark.parametrize("lines", ["Dev1/port0/line0:6", "Dev2/ao0:6"])
def test_each_slot_has_its_own_ground(device, lines):
    with NiSource("Dev1/ai0:63", lines, rate=2000.0) as source:
        source.set_grounds([63, 0, 31, 32, 5])
        found = read(source, 200)
    assert device.clock == (
        "/Dev2/ao/SampleClock" if "ao" in lines else "/Dev1/do/SampleClock"
    )
    assert [got.ground for got, _ in found[:6]] == [63, 0, 31, 32, 5, 63]
    for got, volts in found:
        exact = device.volts[got.ground]
        np.testing.assert_allclose(volts, exact, atol=0.51 * source.scale)
    assert not device.tasks


def test_addresses_enable_one_of_the_two():
    words = [word_of(ground) for ground in range(64)]
    assert len(set(words)) == 64
    assert words[0] == 0b10_00000 and words[31] == 0b10_11111
    assert words[32] == 0b01_00000 and words[63] == 0b01_11111


def test_other_grounds_and_an_overflow_are_gaps(device):
    device.overflow_after = 300
    with NiSource(rate=2000.0) as source:
        read(source, 20)
        source.set_grounds([7])
        found = read(source, 1000)
    assert {got.ground for got, _ in found} == {7}
    gots = [got for got, _ in found]
    assert source.counters.disconnects == 1
    assert sum(got.lost for got in gots) == source.counters.lost
    numbers = np.diff([got.number for got in gots])
    np.testing.assert_array_equal(numbers, [1 + got.lost for got in gots[1:]])


def test_what_does_not_fit_into_a_slot():
    with pytest.raises(ValueError, match="settle: got .*9.4e-05 s.*, expected .*5e-05"):
        NiSource(rate=20e3, settle=30e-6)


def test_what_the_device_cannot_do(device):
    device.slowest = 1.2e-6
    with pytest.raises(ValueError, match="convert: got 1e-06, expected .* here 1.2e-06"):
        NiSource().start()
    assert not device.tasks


def test_without_the_driver_it_says_so():
    with pytest.raises(OSError, match="driver is not installed"):
        NiSource().start()


def test_its_name():
    source = open_source("ni:Dev1/ai0:63,Dev1/port0/line0:6")
    assert isinstance(source, NiSource)
    with pytest.raises(ValueError, match="ni:INPUTS,LINES"):
        open_source("ni:Dev1")
