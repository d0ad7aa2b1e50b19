# What the room offers, imported when it is first used.
from ._batch import (
    Batch as Batch,
    check_limits as check_limits,
    frames_of as frames_of,
)
from ._contract import (
    AbstractMethod as AbstractMethod,
    bits_of as bits_of,
    centred as centred,
    Estimate as Estimate,
    Frame as Frame,
    grounded_of as grounded_of,
    judge as judge,
    masked as masked,
    Part as Part,
    rms as rms,
    Rung as Rung,
)
from ._errors import noise_of as noise_of
from ._linear import Linear as Linear
from ._maps import pixel_divisions as pixel_divisions
from ._names import check_grid as check_grid, method as method, METHODS as METHODS
from ._pure import estimate as estimate, Ready as Ready
from ._rows import (
    DOUBT as DOUBT,
    empty_rows as empty_rows,
    fields_of_rows as fields_of_rows,
    NO_ANSWER as NO_ANSWER,
    Rows as Rows,
)
from ._source import Source as Source
from .points._found import fitting_of as fitting_of
from .points._points import Points as Points, sheet_of as sheet_of, UNIT as UNIT
from .shapes._image_shape import ImageShape as ImageShape

# The rest serves other rooms.
__all__ = [
    "AbstractMethod",
    "Batch",
    "DOUBT",
    "empty_rows",
    "Estimate",
    "estimate",
    "fields_of_rows",
    "Frame",
    "ImageShape",
    "Linear",
    "method",
    "METHODS",
    "NO_ANSWER",
    "Points",
    "Ready",
    "Rows",
    "Rung",
    "Source",
]
