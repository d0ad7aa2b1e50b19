"""Fits a few compact contacts to voltages: in one frame, or from slot to slot.

This room knows the sheet and the errors of voltages. The room knows nothing of images.
"""

from tomojax.kernels.contacts._anew import Candidates as Candidates
from tomojax.kernels.contacts._candidates import (
    along as along,
    best_pairs as best_pairs,
    best_places as best_places,
    explained as explained,
    gains_beside as gains_beside,
    Look as Look,
    look as look,
    own_beside as own_beside,
    weighed_volts as weighed_volts,
)
from tomojax.kernels.contacts._curves import (
    CURVE as CURVE,
    curve as curve,
    limits_of_curve as limits_of_curve,
)
from tomojax.kernels.contacts._discs import discs as discs, limits_of as limits_of
from tomojax.kernels.contacts._equations import (
    best_currents as best_currents,
    Explained as Explained,
    free_slopes as free_slopes,
    normal_of as normal_of,
    unwhitened as unwhitened,
    whiten as whiten,
    whitened_columns as whitened_columns,
    whitened_slopes as whitened_slopes,
    WhitenedFrame as WhitenedFrame,
)
from tomojax.kernels.contacts._field import (
    Among as Among,
    cubic as cubic,
    Field as Field,
    field_at as field_at,
    fields_about as fields_about,
    Near as Near,
    rows_at as rows_at,
    thin_of as thin_of,
    thin_rows_at as thin_rows_at,
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
    whitened as whitened,
)
from tomojax.kernels.contacts._points import (
    DISC as DISC,
    Fitted as Fitted,
    green_of as green_of,
    hardly_told as hardly_told,
    LEAST_DROP as LEAST_DROP,
    LONG as LONG,
    metallic as metallic,
    NARROW as NARROW,
    NOT_ROUND as NOT_ROUND,
    Sheet as Sheet,
    SIZE_WIDTH as SIZE_WIDTH,
)
from tomojax.kernels.contacts._search import (
    Followed as Followed,
    nothing_followed as nothing_followed,
)
from tomojax.kernels.contacts.patches import patches as patches
