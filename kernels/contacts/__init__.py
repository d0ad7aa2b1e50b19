"""A few compact contacts, fitted to voltages: in one frame, or from slot to slot.

The room knows the sheet and the errors of voltages. It knows nothing of images.
"""

from tomojax.kernels.contacts._candidates import (
    apart_from as apart_from,
    best_pairs as best_pairs,
    best_places as best_places,
    gains_beside as gains_beside,
)
from tomojax.kernels.contacts._curves import bar as bar, ring as ring
from tomojax.kernels.contacts._field import (
    Field as Field,
    field_and_slope as field_and_slope,
    field_at as field_at,
    slot_columns as slot_columns,
)
from tomojax.kernels.contacts._follow import follow as follow
from tomojax.kernels.contacts._one_slot import (
    in_slot as in_slot,
    Noise as Noise,
    radius_of as radius_of,
    regular as regular,
    slot_weights as slot_weights,
    solve_small as solve_small,
    tangents as tangents,
    weighed as weighed,
)
from tomojax.kernels.contacts._points import (
    DISC as DISC,
    disc_priors as disc_priors,
    discs as discs,
    Fitted as Fitted,
    green_of as green_of,
    hardly_told as hardly_told,
    LEAST_DROP as LEAST_DROP,
    LONG as LONG,
    metallic as metallic,
    round_disc as round_disc,
    Sheet as Sheet,
    SIZE_WIDTH as SIZE_WIDTH,
)
from tomojax.kernels.contacts._search import (
    Candidates as Candidates,
    Followed as Followed,
    nothing_followed as nothing_followed,
)
from tomojax.kernels.contacts._whiten import (
    currents as currents,
    unwhitened as unwhitened,
    whiten as whiten,
    whitened_columns as whitened_columns,
    WhitenedFrame as WhitenedFrame,
)
