"""Chooses grounds by the paper's adaptive scan, from the voltages of two corner slots.

This room takes voltages and places of electrodes, and gives numbers of electrodes. It knows
nothing of how voltages become images.
"""

from tomojax.kernels.scan._adaptive import (
    around as around,
    contact_region as contact_region,
    contact_regions as contact_regions,
    cop_line as cop_line,
    electrode_currents as electrode_currents,
    nearest_electrodes as nearest_electrodes,
    point as point,
    Region as Region,
    smallest_pitch as smallest_pitch,
)
