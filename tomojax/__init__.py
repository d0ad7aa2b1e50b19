"""Differentiable reconstruction for tomographic tactile sensors."""

from pathlib import Path as _Path

# In a checkout `kernels/` and `hardware/` lie beside this folder, not inside it.
if (_Path(__file__).parent.parent / "kernels" / "__init__.py").is_file():
    __path__.append(str(_Path(__file__).parent.parent))

from tomojax._batch import Batch as Batch, Rows as Rows  # noqa: E402
from tomojax._calibrate import calibrate as calibrate  # noqa: E402
from tomojax._calibrate_recording import (  # noqa: E402
    calibrate_recording as calibrate_recording,
    tare as tare,
)
from tomojax._calibration import Calibration as Calibration  # noqa: E402
from tomojax._chunks import Settings as Settings  # noqa: E402
from tomojax._converter import Converter as Converter  # noqa: E402
from tomojax._design import (  # noqa: E402
    Design as Design,
    design as design,
    patterns_beside as patterns_beside,
)
from tomojax._design_electrodes import (  # noqa: E402
    design_electrodes as design_electrodes,
    ElectrodeDesign as ElectrodeDesign,
    image_scale as image_scale,
    image_spread as image_spread,
)
from tomojax._design_objectives import AbstractObjective as AbstractObjective  # noqa: E402
from tomojax._design_policy import (  # noqa: E402
    design_policy as design_policy,
    load_policy as load_policy,
    PlaceDesigns as PlaceDesigns,
    save_policy as save_policy,
)
from tomojax._design_problem import (  # noqa: E402
    design_objective as design_objective,
    design_places as design_places,
    exploratory_voltages as exploratory_voltages,
)
from tomojax._design_rigs import (  # noqa: E402
    Scenes as Scenes,
    simulate_scenes as simulate_scenes,
)
from tomojax._design_search import relax as relax, Relaxed as Relaxed  # noqa: E402
from tomojax._design_shared import (  # noqa: E402
    design_shared as design_shared,
    SharedDesign as SharedDesign,
)
from tomojax._design_simulated import (  # noqa: E402
    descend_sets as descend_sets,
    ImageError as ImageError,
    tune as tune,
)
from tomojax._faults import Faults as Faults, find_faults as find_faults  # noqa: E402
from tomojax._forward import (  # noqa: E402
    contact_conductance as contact_conductance,
    ground_set as ground_set,
    jacobian as jacobian,
    resistances as resistances,
    voltages as voltages,
)
from tomojax._make_step import make_step as make_step  # noqa: E402
from tomojax._merit import (  # noqa: E402
    cell_size as cell_size,
    Figures as Figures,
    figures_of_merit as figures_of_merit,
    pixels as pixels,
)
from tomojax._method import (  # noqa: E402
    AbstractMethod as AbstractMethod,
    Estimate as Estimate,
    Frame as Frame,
    method as method,
    Rung as Rung,
)
from tomojax._patterns import (  # noqa: E402
    AdaptiveScan as AdaptiveScan,
    exploration as exploration,
    pattern as pattern,
    PATTERNS as PATTERNS,
)
from tomojax._policies import Lookup as Lookup, POLICIES as POLICIES  # noqa: E402
from tomojax._pressure import (  # noqa: E402
    calibrate_presses as calibrate_presses,
    force as force,
    pressure as pressure,
)
from tomojax._reconstruct import (  # noqa: E402
    reconstruct as reconstruct,
    Reconstruction as Reconstruction,
    reduce_jacobian as reduce_jacobian,
)
from tomojax._recording import (  # noqa: E402
    ArrayRecording as ArrayRecording,
    open_recording as open_recording,
    Recording as Recording,
    Rig as Rig,
)
from tomojax._sensor import Sensor as Sensor  # noqa: E402
from tomojax._shapes import (  # noqa: E402
    AbstractOutline as AbstractOutline,
    AbstractShape as AbstractShape,
    Bar as Bar,
    Disc as Disc,
    Ellipse as Ellipse,
    Mask as Mask,
    Moving as Moving,
    Polygon as Polygon,
    Ring as Ring,
    Scene as Scene,
    Shifted as Shifted,
)
from tomojax._step import Output as Output, Step as Step  # noqa: E402
from tomojax._stream import (  # noqa: E402
    reconstruct_recording as reconstruct_recording,
)
from tomojax._track import (  # noqa: E402
    Touch as Touch,
    touches as touches,
    track as track,
    Tracks as Tracks,
)
from tomojax.kernels import Flag as Flag, ReducedSlots as ReducedSlots  # noqa: E402
