"""Describes the rig and what touches it: sensors, shapes, converters, exact voltages.

This room states what is there and computes what would be measured. The room knows nothing
of how contacts are found.
"""

from tomojax.sensor._calibration import Calibration as Calibration, WAVES as WAVES
from tomojax.sensor._converter import Converter as Converter
from tomojax.sensor._edges import (
    AbstractEdge as AbstractEdge,
    PolygonEdge as PolygonEdge,
    RoundEdge as RoundEdge,
)
from tomojax.sensor._field import make_among as make_among, make_field as make_field
from tomojax.sensor._field_slopes import make_moves as make_moves, make_waves as make_waves
from tomojax.sensor._forward import (
    compiled_resistances as compiled_resistances,
    contact_conductance as contact_conductance,
    exact_voltages as exact_voltages,
    ground_set as ground_set,
    jacobian as jacobian,
    resistances as resistances,
    sheet_on_mesh as sheet_on_mesh,
    voltages as voltages,
)
from tomojax.sensor._outline import (
    AbstractOutline as AbstractOutline,
    AbstractShape as AbstractShape,
)
from tomojax.sensor._scene import (
    Mask as Mask,
    Moving as Moving,
    Scene as Scene,
    Shifted as Shifted,
)
from tomojax.sensor._sensor import (
    converter_of as converter_of,
    nominal_noise as nominal_noise,
    Sensor as Sensor,
)
from tomojax.sensor._shapes import (
    Bar as Bar,
    Disc as Disc,
    Ellipse as Ellipse,
    Polygon as Polygon,
    Ring as Ring,
)
from tomojax.sensor.meshes import GridSurface as GridSurface, ToldSheet as ToldSheet

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
