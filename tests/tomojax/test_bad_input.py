"""Every argument's mistakes give a ValueError that names the argument."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

import tomojax as tx

XY = [[0.01, 0.01], [0.03, 0.03]]
SENSORS = {
    "outside": ("electrode_xy", dict(electrode_xy=[[0.01, 0.01], [0.039, 0.03]])),
    "overlapping": ("electrode_xy", dict(electrode_xy=[[0.01, 0.01], [0.014, 0.01]])),
    "one electrode": ("electrode_xy", dict(electrode_xy=[[0.01, 0.01]])),
    "wrong shape": ("electrode_xy", dict(electrode_xy=[0.01, 0.01])),
    "not a place": ("electrode_xy", dict(electrode_xy=[[0.01, np.nan], [0.03, 0.03]])),
    "words": ("electrode_xy", dict(electrode_xy="here")),
    "ragged": ("electrode_xy", dict(electrode_xy=[[0.01], [0.03, 0.03]])),
    "coarse mesh": ("divisions", dict(divisions=(4, 16))),
    "half a cell": ("divisions", dict(divisions=(16.5, 16))),
    "one number": ("divisions", dict(divisions=16)),
    "negative sheet": ("sheet_resistance", dict(sheet_resistance=-1e4)),
    "zero sheet": ("sheet_resistance", dict(sheet_resistance=0.0)),
    "hole of NaN": ("sheet_resistance", dict(sheet_resistance=np.full(512, np.nan))),
    "sheet of another mesh": ("sheet_resistance", dict(sheet_resistance=np.ones(12))),
    "negative ground": ("ground_resistance", dict(ground_resistance=-4.0)),
    "grounds that do not fit": ("ground_resistance", dict(ground_resistance=[4.0] * 3)),
    "no diameter": ("electrode_diameter", dict(electrode_diameter=0.0)),
    "negative codes": ("resolution", dict(resolution=-1e-3)),
    "infinite drive": ("drive_voltage", dict(drive_voltage=np.inf)),
    "no width": ("size", dict(size=[0.0, 0.04])),
    "one side": ("size", dict(size=0.04)),
}


@pytest.mark.parametrize("case", SENSORS)
def test_sensor(case) -> None:
    name, changes = SENSORS[case]
    good = dict(size=[0.04, 0.04], electrode_xy=XY, divisions=(16, 16))
    tx.Sensor(**good)
    with pytest.raises(ValueError, match=name) as error:
        tx.Sensor(**good | changes)
    assert "got" in str(error.value) and "expected" in str(error.value)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("rows", dict(rows=0)),
        ("columns", dict(columns=-2)),
        ("pitch", dict(pitch=0.0)),
        ("margin", dict(margin=[0.01, -0.01])),
        ("electrode_xy", dict(margin=0.001)),
    ],
)
def test_grid(name, arguments) -> None:
    with pytest.raises(ValueError, match=name):
        tx.Sensor.grid(**arguments)


@pytest.mark.parametrize(
    "name, make",
    [
        ("radius", lambda: tx.Disc([0, 0], -1.0, 1.0)),
        ("radius", lambda: tx.Disc([0, 0], [1.0, 2.0], 1.0)),
        ("center", lambda: tx.Disc([0, 0, 0], 1.0, 1.0)),
        ("center", lambda: tx.Disc([0, np.nan], 1.0, 1.0)),
        ("conductance", lambda: tx.Disc([0, 0], 1.0, -1.0)),
        ("conductance", lambda: tx.Disc([0, 0], 1.0, np.nan)),
        ("semi_axes", lambda: tx.Ellipse([0, 0], [1.0, 0.0], 0.0, 1.0)),
        ("angle", lambda: tx.Bar([0, 0], 1.0, 1.0, np.inf, 1.0)),
        ("width", lambda: tx.Bar([0, 0], 1.0, 0.0, 0.0, 1.0)),
        ("outer − inner", lambda: tx.Ring([0, 0], 2.0, 1.0, 1.0)),
        ("vertices", lambda: tx.sensor.Polygon([[0, 0], [1, 1]], 1.0)),
        ("conductance", lambda: tx.sensor.Mask([1.0, 2.0])),
        ("shapes", lambda: tx.Scene([tx.Disc([0, 0], 1.0, 1.0)])),
        ("steps between times", lambda: tx.sensor.Moving(tx.Scene(), [0, 0], [[0, 0]] * 2)),
        ("offsets", lambda: tx.sensor.Moving(tx.Scene(), [0, 1], [[0, 0]] * 3)),
        ("factors", lambda: tx.sensor.Moving(tx.Scene(), [0, 1], [[0, 0]] * 2, [1, -1])),
        ("bits", lambda: tx.Converter(bits=0)),
        ("noise", lambda: tx.Converter(noise=-1.0)),
        ("full_scale", lambda: tx.Converter(full_scale=0.0)),
        ("key", lambda: tx.Converter()(jnp.zeros(3))),
    ],
)
def test_shapes_and_converter(name, make) -> None:
    # The runtime type check of the tests is before ours where a type is wrong.
    with pytest.raises((ValueError, TypeCheckError), match=name):
        make()


@pytest.mark.parametrize(
    "grounds",
    [
        [],
        [-1],
        [8],
        [[0, 1]],
        np.zeros((0, 8)),
        np.zeros((2, 8)),
        np.full((1, 8), -1.0),
        np.full((1, 8), np.nan),
        np.ones((1, 7)),
        "all",
        [True, False],
        np.ones(8),
    ],
)
def test_grounds(small_sensor, grounds) -> None:
    with pytest.raises(ValueError, match="grounds"):
        tx.voltages(small_sensor, tx.Scene(), grounds)
    with pytest.raises(ValueError, match="grounds"):
        tx.jacobian(small_sensor, grounds)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("scene", dict(scene=np.zeros(3))),
        ("scene", dict(scene=np.full(320, -1.0))),
        ("scene", dict(scene=np.full(320, np.nan))),
        ("scene", dict(scene=tx.Scene(), times=[0.0])),
        ("times", dict(scene=lambda t: tx.Scene())),
        ("times", dict(scene=lambda t: tx.Scene(), times=[0.0, 1.0])),
        ("key", dict(scene=tx.Scene(), converter=tx.Converter())),
    ],
)
def test_voltages(small_sensor, name, arguments) -> None:
    with pytest.raises(ValueError, match=name):
        tx.voltages(small_sensor, grounds=[0], **arguments)


@pytest.mark.parametrize(
    "name, arguments",
    [
        ("contact_resistance", dict(contact_resistance=-1.0)),
        ("contact_resistance", dict(contact_resistance=np.nan)),
        ("contact_resistance", dict(contact_resistance=np.ones(3))),
        ("route", dict(route="bem")),
    ],
)
def test_jacobian(small_sensor, name, arguments) -> None:
    with pytest.raises((ValueError, TypeCheckError), match=name):
        tx.jacobian(small_sensor, **arguments)


def test_series_needs_an_even_sheet(small_sensor) -> None:
    uneven = dataclasses.replace(small_sensor, sheet_resistance=np.full(320, 1e4))
    with pytest.raises(ValueError, match="sheet_resistance"):
        tx.sensor.resistances(uneven, "series")


def test_traced_values_are_not_checked(small_sensor) -> None:
    def total(rho):
        sensor = dataclasses.replace(small_sensor, sheet_resistance=rho)
        return tx.voltages(sensor, tx.Disc([0.03, 0.02], 0.004, 1.0)).sum()

    assert np.isfinite(jax.jit(jax.grad(total))(1e4))
