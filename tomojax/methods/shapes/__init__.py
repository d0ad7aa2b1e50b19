"""`shape`: the likeliest shape of the touching object, and how sure the shape is.

The model fits a frame, a description reads contacts off it, and the method keeps the
contract of the ladder. The folder knows no other rung than `source`.
"""

from tomojax.methods.shapes._described import described as described
from tomojax.methods.shapes._image_shape import ImageShape as ImageShape
from tomojax.methods.shapes._model import (
    PreparedShape as PreparedShape,
    ShapeModel as ShapeModel,
)
