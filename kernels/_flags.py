"""What compiled code says of a frame instead of raising: bits of one integer."""

import enum


class Flag(enum.IntFlag):
    """Bits of a flag. 0 is a good frame."""

    NO_CONTACT = 1  # no voltage above the threshold
    BAD_VOLTAGES = 2  # NaN or infinite
    NO_DIRECTION = 4  # a contact as wide as long
    WHOLE_SHEET = 8  # every electrode in contact: nothing to adapt to
    BAD_LAMBDA = 16  # λ not above 0, or no rule could choose one
    BAD_GROUNDS = 32  # out of range, repeated, or no weight
    SOLVE_FAILED = 64  # a factorisation or the image is not finite
