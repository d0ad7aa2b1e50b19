"""Arrays in, arrays out: the sheet's physics as compiled, differentiable functions.

Nothing here holds state, reads files or checks values; `tomojax` does.
"""

from tomojax.kernels._basis import (
    slot_basis as slot_basis,
    slot_factors as slot_factors,
)
from tomojax.kernels._fem import (
    fem_contact as fem_contact,
    fem_resistances as fem_resistances,
    fem_sheet as fem_sheet,
    fem_site_resistances as fem_site_resistances,
    FemSheet as FemSheet,
    site_conductance as site_conductance,
)
from tomojax.kernels._rectangle import (
    rectangle_green as rectangle_green,
    rectangle_resistances as rectangle_resistances,
)
from tomojax.kernels._reduction import (
    ContactReduction as ContactReduction,
    ground_currents as ground_currents,
    ground_voltages as ground_voltages,
    reduce_contact as reduce_contact,
    shared_ground_voltages as shared_ground_voltages,
    touch_electrodes as touch_electrodes,
    voltage_drop as voltage_drop,
    voltage_sensitivity as voltage_sensitivity,
)
from tomojax.kernels._slots import (
    contact_jacobian as contact_jacobian,
    loop_resistance as loop_resistance,
    shared_slot_map as shared_slot_map,
    slot_map as slot_map,
)
from tomojax.kernels._table import centred as centred, Resistances as Resistances
