"""Arrays in, arrays out: the sheet's physics as compiled, differentiable functions.

Nothing here holds state, reads files or checks values; `tomojax` does.
"""

from tomojax.kernels._adaptive import (
    around as around,
    contact_region as contact_region,
    contact_regions as contact_regions,
    cop_line as cop_line,
    DIRECTIONS as DIRECTIONS,
    electrode_currents as electrode_currents,
    nearest_electrodes as nearest_electrodes,
    pitch as pitch,
    point as point,
    Region as Region,
)
from tomojax.kernels._basis import (
    reduce_slots as reduce_slots,
    ReducedSlots as ReducedSlots,
    row_basis as row_basis,
    slot_basis as slot_basis,
    slot_factors as slot_factors,
    solve_reduced as solve_reduced,
)
from tomojax.kernels._contacts import (
    Contacts as Contacts,
    largest_variance as largest_variance,
    no_contacts as no_contacts,
    read_contacts as read_contacts,
)
from tomojax.kernels._drawing import (
    points_as_contacts as points_as_contacts,
    points_image as points_image,
)
from tomojax.kernels._explained import (
    point_sources as point_sources,
    unexplained as unexplained,
)
from tomojax.kernels._fem import (
    fem_contact as fem_contact,
    fem_resistances as fem_resistances,
    fem_sheet as fem_sheet,
    fem_site_resistances as fem_site_resistances,
    FemSheet as FemSheet,
    site_conductance as site_conductance,
)
from tomojax.kernels._field import (
    Field as Field,
    field_and_slope as field_and_slope,
    field_at as field_at,
    slot_columns as slot_columns,
)
from tomojax.kernels._flags import Flag as Flag
from tomojax.kernels._lambda import (
    choose_lambda as choose_lambda,
    lambda_grid as lambda_grid,
    lambda_scores as lambda_scores,
    LambdaRule as LambdaRule,
    Spectrum as Spectrum,
    spectrum as spectrum,
)
from tomojax.kernels._merit import (
    greit_figures as greit_figures,
    GreitFigures as GreitFigures,
    half_area_radius as half_area_radius,
    half_width as half_width,
    image_error as image_error,
    image_place as image_place,
    two_point_dip as two_point_dip,
)
from tomojax.kernels._rectangle import (
    rectangle_fields as rectangle_fields,
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
from tomojax.kernels._tikhonov import (
    SolveRoute as SolveRoute,
    tikhonov as tikhonov,
)
