"""Describes the rig and what touches it: sensors, shapes, converters, exact voltages.

This room states what is there and computes what would be measured. The room knows nothing
of how contacts are found.
"""

from tomojax.sensor._calibration import Calibration, WAVES as WAVES
from tomojax.sensor._converter import Converter
from tomojax.sensor._edges import AbstractEdge, PolygonEdge, RoundEdge
from tomojax.sensor._field import (
    make_among as make_among,
    make_field as make_field,
    make_fields as make_fields,
    make_moves as make_moves,
    make_waves as make_waves,
)
from tomojax.sensor._forward import (
    compiled_resistances as compiled_resistances,
    contact_conductance,
    exact_voltages as exact_voltages,
    ground_set,
    jacobian,
    resistances,
    sheet_on_mesh,
    voltages,
)
from tomojax.sensor._outline import (
    AbstractOutline,
    AbstractShape,
    Mask,
    Moving,
    Scene,
    Shifted,
)
from tomojax.sensor._placing import box_in_space as box_in_space
from tomojax.sensor._sensor import converter_of, nominal_noise, Sensor
from tomojax.sensor._shapes import Bar, Disc, Ellipse, Polygon, Ring
from tomojax.sensor.meshes._grid_surface import GridSurface
from tomojax.sensor.meshes._told import ToldSheet

# The rest serves other rooms.
__all__ = [
    "AbstractEdge",
    "AbstractOutline",
    "AbstractShape",
    "Bar",
    "Calibration",
    "contact_conductance",
    "Converter",
    "converter_of",
    "Disc",
    "Ellipse",
    "GridSurface",
    "ground_set",
    "jacobian",
    "Mask",
    "Moving",
    "nominal_noise",
    "Polygon",
    "PolygonEdge",
    "resistances",
    "Ring",
    "RoundEdge",
    "Scene",
    "Sensor",
    "sheet_on_mesh",
    "Shifted",
    "ToldSheet",
    "voltages",
]
