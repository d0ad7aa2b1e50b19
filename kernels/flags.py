"""Names the faults that compiled code reports for a frame, as bits of one integer."""

import enum

import numpy as np


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

    `meaning` says what was seen, `advice` what to do, `explanation` both in sentences.

    **Example:**

    >>> import tomojax as tx
    >>> flags = 16384 + 1  # as a row of results has it
    >>> bool(flags & tx.Flag.HIGH_RESIDUAL)
    True
    >>> [flag.name for flag in tx.Flag(flags)]
    ['NO_CONTACT', 'HIGH_RESIDUAL']
    >>> tx.Flag.GAP.meaning
    'scans or slots were lost just before this row'
    """

    NO_CONTACT = 1
    BAD_VOLTAGES = 2
    NO_DIRECTION = 4
    WHOLE_SHEET = 8
    BAD_LAMBDA = 16
    BAD_GROUNDS = 32
    SOLVE_FAILED = 64
    # Of a recording's rows:
    DEAD_CHANNEL = 128
    STUCK_CHANNEL = 256
    SATURATED = 512
    UNKNOWN_GROUND = 1024
    GAP = 2048
    ALL_ZERO = 4096
    STUCK_SCAN = 8192
    HIGH_RESIDUAL = 16384
    NO_DATA = 32768
    MODEL_LIMITED = 65536
    HURRIED = 131072
    CONTACTS_UNEXPLAINED = 262144
    PLACE_UNCERTAIN = 524288
    CONDUCTANCE_UNCERTAIN = 1048576
    CLOCK_MENDED = 2097152
    GROUND_NOT_LOWEST = 4194304
    AGAINST_DRIVE = 8388608
    RIG_FAULT = 16777216
    COUNT_UNCERTAIN = 33554432

    @classmethod
    def _missing_(cls, value: object) -> "Flag | None":
        """Takes NumPy's integers, which is what arrays of flags hold."""
        whole = isinstance(value, np.integer)
        return cls(int(value)) if whole else super()._missing_(value)

    @property
    def level(self) -> Level:
        """Returns the highest level among the flag's bits."""
        if self & NO_ANSWER:
            return Level.NO_ANSWER
        return Level.DOUBT if self & DOUBT else Level.INFORMATION

    @property
    def meaning(self) -> str:
        """Says what was seen, bit by bit."""
        return "; ".join(_TOLD[one][0] for one in self)

    @property
    def advice(self) -> str:
        """Says what to do about it, bit by bit."""
        return "; ".join(_TOLD[one][1] for one in self)

    @property
    def explanation(self) -> str:
        """Gives meaning and advice as two sentences, bit by bit."""
        parts = (part for one in self for part in _TOLD[one])
        return " ".join(f"{part[:1].upper()}{part[1:]}." for part in parts)


# The sentence and the advice of each flag: for reports, results files and the page.
_TOLD = {
    Flag.NO_CONTACT: (
        "no voltage is above the threshold, so nothing touches the sheet",
        "nothing is wrong; lower --threshold for very faint contacts",
    ),
    Flag.BAD_VOLTAGES: (
        "some voltages are NaN or infinite",
        "look at the converter; the other channels were used",
    ),
    Flag.NO_DIRECTION: (
        "the contact is as wide as it is long, so it has no direction",
        "nothing is wrong; do not use its angle",
    ),
    Flag.WHOLE_SHEET: (
        "every electrode is in contact, so there is nothing to adapt to",
        "use a fixed pattern, such as all",
    ),
    Flag.BAD_LAMBDA: (
        "λ is not above 0, is below what float32 holds, or no rule could choose one",
        "give --lam",
    ),
    Flag.BAD_GROUNDS: (
        "a ground is out of range or repeated, or no slot has a weight",
        "check the numbers of the grounded electrodes",
    ),
    Flag.SOLVE_FAILED: (
        "a factorisation or the image is not finite",
        "raise --lam; if it stays, the recording's voltages are not usable",
    ),
    Flag.DEAD_CHANNEL: (
        "a channel reads 0 while others change, and is not used",
        "check its wire; tomojax check names it",
    ),
    Flag.STUCK_CHANNEL: (
        "a channel repeats one value while others change, and is not used",
        "check its wire; tomojax check names it",
    ),
    Flag.SATURATED: (
        "voltages are at the converter's rail, or beyond what the drive can make",
        "lower the drive or the converter's gain",
    ),
    Flag.UNKNOWN_GROUND: (
        "the slot was lost, or its ground is no electrode of the sensor",
        "where no slots were lost, check the ground lines and their numbers",
    ),
    Flag.GAP: (
        "scans or slots were lost just before this row",
        "the row holds; if gaps are many, lower the rate or look at the link",
    ),
    Flag.ALL_ZERO: (
        "every channel reads 0",
        "check that the object is driven and the converter runs",
    ),
    Flag.STUCK_SCAN: (
        "every voltage repeats the scan before or after",
        "the rig sent old values: look at its firmware or its buffer",
    ),
    Flag.HIGH_RESIDUAL: (
        "the model leaves too much of the voltages unexplained",
        "allow more --contacts, calibrate the rig, or take --method auto or shape",
    ),
    Flag.NO_DATA: (
        "too few good channels are left for a result",
        "look at the other flags of these rows",
    ),
    Flag.MODEL_LIMITED: (
        "voltages err more than nominal values let them, so σ is wider",
        "calibrate the rig: tomojax calibrate",
    ),
    Flag.HURRIED: (
        "a cheaper method answered, to keep the step's deadline",
        "the row holds; raise --budget or lower the rate for the full method",
    ),
    Flag.CONTACTS_UNEXPLAINED: (
        "the contacts read off an image are not all that it shows",
        "look at the image; allow more --contacts, or take --method auto or points",
    ),
    Flag.PLACE_UNCERTAIN: (
        "a place is no better known than to half a pitch",
        "measure more slots, press harder, or calibrate the rig",
    ),
    Flag.CONDUCTANCE_UNCERTAIN: (
        "a contact imposes its potential, so its conductance is hardly told",
        "trust the place; put a resistor in series to measure the conductance",
    ),
    Flag.CLOCK_MENDED: (
        "the rig's clock fell or stood, so the row's time is made up from its rate",
        "trust places, not times; tomojax repair writes the times into the file",
    ),
    Flag.GROUND_NOT_LOWEST: (
        "another electrode is lower than the one told as grounded",
        "check the ground lines and their order: tomojax check",
    ),
    Flag.AGAINST_DRIVE: (
        "voltages are against the direction of the drive",
        "check the sign of drive_voltage and of the converter's scale",
    ),
    Flag.RIG_FAULT: (
        "a short, a leak, crosstalk or a wrong channel explains what contacts do not",
        "the row holds; look at wires and switches with tomojax info and check",
    ),
    Flag.COUNT_UNCERTAIN: (
        "two contacts near each other and one long contact explain the voltages alike",
        "calibrate the rig, or wait until the contacts have moved apart",
    ),
}

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
    | Flag.COUNT_UNCERTAIN
    | Flag.GROUND_NOT_LOWEST
    | Flag.AGAINST_DRIVE
    | NO_ANSWER
)
