"""Finds ground conditions, λ and electrodes' places that are best for a purpose.

`objectives` rates a set of slots; the searches of this folder make an objective small. The
folder knows nothing of recordings, nor of results.
"""

from tomojax.design._by_place import (
    design_policy,
    designs_by_place as designs_by_place,
    PlaceDesigns,
)
from tomojax.design._compare import compare_patterns, PatternFigures, PatternTable
from tomojax.design._descend import descend_sets, tune
from tomojax.design._design import (
    Design,
    design,
    each_its_own as each_its_own,
    patterns_beside,
)
from tomojax.design._electrodes import (
    design_electrodes,
    ElectrodeDesign,
    image_scale,
    image_spread,
)
from tomojax.design._search import exchange as exchange, relax, Relaxed
from tomojax.design.objectives._image_error import ImageError
from tomojax.design.objectives._information import (
    AbstractObjective,
    ImageVariance,
    shape_objective as shape_objective,
    ShapeInformation as ShapeInformation,
)
from tomojax.design.objectives._problem import (
    design_objective,
    design_places,
    exploratory_voltages,
)
from tomojax.design.objectives._rigs import simulate_scenes, SimulatedScenes
from tomojax.design.objectives._scores import score as score

# The rest serves other rooms.
__all__ = [
    "AbstractObjective",
    "compare_patterns",
    "descend_sets",
    "Design",
    "design",
    "design_electrodes",
    "design_objective",
    "design_places",
    "design_policy",
    "ElectrodeDesign",
    "exploratory_voltages",
    "image_scale",
    "image_spread",
    "ImageError",
    "ImageVariance",
    "PatternFigures",
    "patterns_beside",
    "PatternTable",
    "PlaceDesigns",
    "relax",
    "Relaxed",
    "simulate_scenes",
    "SimulatedScenes",
    "tune",
]
