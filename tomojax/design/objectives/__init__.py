"""Rates a set of ground conditions for a purpose, as figures of weights over slots.

The folder never imports a search.
"""

from tomojax.design.objectives._contacts import Contact as Contact
from tomojax.design.objectives._image_error import ImageError as ImageError
from tomojax.design.objectives._information import (
    AbstractObjective as AbstractObjective,
    ImageVariance as ImageVariance,
)
from tomojax.design.objectives._problem import (
    design_objective as design_objective,
    design_places as design_places,
    exploratory_voltages as exploratory_voltages,
)
from tomojax.design.objectives._rigs import (
    exact_on_rig as exact_on_rig,
    simulate_scenes as simulate_scenes,
    SimulatedScenes as SimulatedScenes,
)
from tomojax.design.objectives._scores import score as score
from tomojax.design.objectives._shapes import (
    shape_objective as shape_objective,
    ShapeInformation as ShapeInformation,
)
