"""Names the faults that compiled code reports for a frame, as bits of one integer."""

import enum


class Level(enum.IntEnum):
    """How much a flag lowers the trust in a row of results.

    **Example:**

    >>> import tomojax as tx
    >>> flags = tx.Flag.MODEL_LIMITED | tx.Flag.HIGH_RESIDUAL
    >>> tx.Flag(flags).level.name
    'DOUBT'
    """

    INFORMATION = 0  # the row holds
    DOUBT = 1  # a place may be far off, or a contact is missing
    NO_ANSWER = 2  # the row says nothing


class Flag(enum.IntFlag):
    """Bits of a flag; `level` says how much the bits lower the trust in a row of results.

    **Example:**

    >>> import tomojax as tx
    >>> flags = 16384 + 1  # as a row of results has it
    >>> bool(flags & tx.Flag.HIGH_RESIDUAL)
    True
    >>> [flag.name for flag in tx.Flag(flags)]
    ['NO_CONTACT', 'HIGH_RESIDUAL']
    """

    NO_CONTACT = 1  # no voltage above the threshold
    BAD_VOLTAGES = 2  # NaN or infinite
    NO_DIRECTION = 4  # a contact as wide as long
    WHOLE_SHEET = 8  # every electrode in contact: nothing to adapt to
    BAD_LAMBDA = 16  # λ not above 0, below what float32 holds, or no rule could choose one
    BAD_GROUNDS = 32  # out of range, repeated, or no weight
    SOLVE_FAILED = 64  # a factorisation or the image is not finite
    # Of a recording's rows:
    DEAD_CHANNEL = 128  # a channel reads 0 while others change
    STUCK_CHANNEL = 256  # a channel repeats another value while others change
    SATURATED = 512  # voltages at the converter's rail, or beyond what the drive can make
    UNKNOWN_GROUND = 1024  # a slot whose ground is no electrode of the sensor
    GAP = 2048  # scans lost just before this row
    ALL_ZERO = 4096  # every channel reads 0
    STUCK_SCAN = 8192  # every voltage repeats the scan before or after
    HIGH_RESIDUAL = 16384  # the model leaves too much of the voltages unexplained
    NO_DATA = 32768  # too few good channels: no result
    MODEL_LIMITED = 65536  # voltages err more than nominal values let them: σ is wider
    HURRIED = 131072  # a cheaper method answered, to keep a step's deadline
    CONTACTS_UNEXPLAINED = 262144  # the contacts read off an image are not all it shows
    PLACE_UNCERTAIN = 524288  # a place is no better known than to half a pitch
    CONDUCTANCE_UNCERTAIN = 1048576  # a contact imposes its potential: g is hardly told
    CLOCK_MENDED = 2097152  # the row's time is not the rig's clock's, which fell or stood
    GROUND_NOT_LOWEST = 4194304  # another electrode is lower than the one told as grounded
    AGAINST_DRIVE = 8388608  # voltages are against the direction of the drive

    @property
    def level(self) -> Level:
        """Returns the highest level among the flag's bits."""
        if self & NO_ANSWER:
            return Level.NO_ANSWER
        return Level.DOUBT if self & DOUBT else Level.INFORMATION


# Of one of these a row says nothing.
NO_ANSWER = Flag.SOLVE_FAILED | Flag.NO_DATA

# With one of these a row is not to be trusted as it stands.
DOUBT = (
    Flag.BAD_LAMBDA
    | Flag.BAD_GROUNDS
    | Flag.SATURATED
    | Flag.HIGH_RESIDUAL
    | Flag.CONTACTS_UNEXPLAINED
    | Flag.PLACE_UNCERTAIN
    | Flag.GROUND_NOT_LOWEST
    | Flag.AGAINST_DRIVE
    | NO_ANSWER
)
