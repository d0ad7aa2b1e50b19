"""`shape`: the likeliest shape of what touches, and how sure it is.

The model fits a frame, a description reads contacts off it, and the method keeps the
contract of the ladder. The room knows nothing of other rungs but `source`.
"""

from tomojax.methods.shapes._described import described as described
from tomojax.methods.shapes._image_shape import ImageShape as ImageShape
from tomojax.methods.shapes._model import (
    PreparedShape as PreparedShape,
    ShapeModel as ShapeModel,
)
