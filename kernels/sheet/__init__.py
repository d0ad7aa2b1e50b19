"""Computes the sheet's physics: mesh, electrodes, resistances, slots, exact contacts.

This room turns a sheet into resistances and resistances into voltages. The room knows
nothing of images, of noise or of how contacts are found.
"""

from tomojax.kernels.sheet._electrodes import feed_parts as feed_parts
from tomojax.kernels.sheet._fem import (
    fem_contact as fem_contact,
    fem_fields as fem_fields,
    fem_resistances as fem_resistances,
    fem_shared_resistances as fem_shared_resistances,
    fem_sheet as fem_sheet,
    FemSheet as FemSheet,
    site_conductance as site_conductance,
)
from tomojax.kernels.sheet._mesh import (
    block_shape as block_shape,
    cell_centres as cell_centres,
    cell_sides as cell_sides,
    centroids as centroids,
    element_area as element_area,
    node_image as node_image,
    nodes as nodes,
    subpoints as subpoints,
    triangles as triangles,
)
from tomojax.kernels.sheet._rectangle import (
    rectangle_fields as rectangle_fields,
    rectangle_green as rectangle_green,
    rectangle_resistances as rectangle_resistances,
    rectangle_slope as rectangle_slope,
)
from tomojax.kernels.sheet._rectangle_grid import (
    rectangle_grid_fields as rectangle_grid_fields,
)
from tomojax.kernels.sheet._reduction import (
    ContactReduction as ContactReduction,
    ground_voltages as ground_voltages,
    reduce_sites as reduce_sites,
    voltage_drop as voltage_drop,
    voltage_slopes as voltage_slopes,
)
from tomojax.kernels.sheet._skin import (
    coverage as coverage,
    element_areas as element_areas,
    local_cells as local_cells,
    Skin as Skin,
    stretch as stretch,
)
from tomojax.kernels.sheet._slots import (
    Conditions as Conditions,
    conditions_of as conditions_of,
    contact_jacobian as contact_jacobian,
    Grounds as Grounds,
    lengthened as lengthened,
    Resistances as Resistances,
    slot_jacobian as slot_jacobian,
    Slots as Slots,
    volts_per_ampere as volts_per_ampere,
)
from tomojax.kernels.sheet._stiffness import reference_stiffness as reference_stiffness
from tomojax.kernels.sheet._waves import (
    cosine_waves as cosine_waves,
    disc_mean as disc_mean,
    heights as heights,
    rectangle_wave_fields as rectangle_wave_fields,
    smooth_modes as smooth_modes,
    smooth_orders as smooth_orders,
)
