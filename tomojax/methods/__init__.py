"""The ladder of models: from the voltages of a frame to contacts and an image.

Each method has a file of its own and keeps one contract; `method` finds them by name
and `Batch` applies them to many frames. The room knows nothing of files, nor of what is
grounded next.
"""

from tomojax.kernels.flags import DOUBT as DOUBT, NO_ANSWER as NO_ANSWER
from tomojax.methods._batch import (
    Batch as Batch,
    check_limits as check_limits,
    frames_of as frames_of,
)
from tomojax.methods._contract import (
    AbstractMethod as AbstractMethod,
    Estimate as Estimate,
    Frame as Frame,
    judge as judge,
    rms as rms,
    Rung as Rung,
)
from tomojax.methods._errors import noise_of as noise_of
from tomojax.methods._linear import Linear as Linear
from tomojax.methods._names import method as method, METHODS as METHODS
from tomojax.methods._pixels import pixel_divisions as pixel_divisions
from tomojax.methods._rows import (
    empty_rows as empty_rows,
    fields_of_rows as fields_of_rows,
    Rows as Rows,
)
from tomojax.methods._source import Source as Source
from tomojax.methods.points import (
    fitting_of as fitting_of,
    Points as Points,
    sheet_of as sheet_of,
    UNIT as UNIT,
)
from tomojax.methods.shapes import ImageShape as ImageShape, ShapeModel as ShapeModel

# The rest serves other rooms.
__all__ = [
    "AbstractMethod",
    "Batch",
    "DOUBT",
    "empty_rows",
    "Estimate",
    "fields_of_rows",
    "Frame",
    "ImageShape",
    "Linear",
    "method",
    "METHODS",
    "NO_ANSWER",
    "Points",
    "Rows",
    "Rung",
    "Source",
]
