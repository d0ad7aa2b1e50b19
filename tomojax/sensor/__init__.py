"""Describes the rig and what touches it: sensors, shapes, converters, exact voltages.

This room states what is there and computes what would be measured. The room knows nothing
of how contacts are found.

The names of `__init__.pyi` are imported when they are first used.
"""

import lazy_loader as _lazy

# The names are in the stub.
# pyright: reportUnsupportedDunderAll=false
__getattr__, __dir__, _ = _lazy.attach_stub(__name__, __file__)

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
