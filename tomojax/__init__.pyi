# The public face: what `import tomojax as tx` offers, and all of it. Read at run time too.
from . import (
    bringup as bringup,
    calibration as calibration,
    design as design,
    methods as methods,
    paper as paper,
    recordings as recordings,
    results as results,
    sensor as sensor,
    step as step,
)
from .calibration import calibrate_recording as calibrate_recording
from .kernels.flags import Flag as Flag
from .methods import Batch as Batch, method as method
from .paper import pattern as pattern, reconstruct as reconstruct
from .recordings import find_faults as find_faults, open_recording as open_recording
from .results import reconstruct_recording as reconstruct_recording, track as track
from .sensor import (
    Bar as Bar,
    Calibration as Calibration,
    Converter as Converter,
    Disc as Disc,
    Ellipse as Ellipse,
    jacobian as jacobian,
    Ring as Ring,
    Scene as Scene,
    Sensor as Sensor,
    voltages as voltages,
)
from .step import make_step as make_step
