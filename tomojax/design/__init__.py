"""Finds ground conditions, λ and electrodes' places that are best for a purpose.

`objectives` rates a set of slots; the searches of this folder make an objective small. The
folder knows nothing of recordings, nor of results.
"""

from tomojax.design._by_place import (
    design_policy as design_policy,
    designs_by_place as designs_by_place,
    PlaceDesigns as PlaceDesigns,
)
from tomojax.design._compare import (
    compare_patterns as compare_patterns,
    PatternFigures as PatternFigures,
    PatternTable as PatternTable,
)
from tomojax.design._descend import descend_sets as descend_sets, tune as tune
from tomojax.design._design import (
    Design as Design,
    design as design,
    each_its_own as each_its_own,
    patterns_beside as patterns_beside,
)
from tomojax.design._electrodes import (
    design_electrodes as design_electrodes,
    ElectrodeDesign as ElectrodeDesign,
    image_scale as image_scale,
    image_spread as image_spread,
)
from tomojax.design._search import exchange as exchange, relax as relax, Relaxed as Relaxed
from tomojax.design.objectives import (
    AbstractObjective as AbstractObjective,
    design_objective as design_objective,
    design_places as design_places,
    exploratory_voltages as exploratory_voltages,
    ImageError as ImageError,
    ImageVariance as ImageVariance,
    score as score,
    shape_objective as shape_objective,
    ShapeInformation as ShapeInformation,
    simulate_scenes as simulate_scenes,
    SimulatedScenes as SimulatedScenes,
)

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
