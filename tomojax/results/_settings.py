"""What decides the rows of a results file, beside the recording."""

from dataclasses import dataclass

from tomojax._require import require
from tomojax.methods import check_limits
from tomojax.recordings import CHUNK_SLOTS, Rate, Recording

# Bytes of a chunk's images.
_CHUNK_IMAGES = 1 << 26


@dataclass(frozen=True)
class Settings:
    """What decides the rows of a results file, beside the recording.

    `lam` None is the method's own choice from the first frames with a contact; `grid` None
    is 32 × 32 pixels, or 24 × 24 for a row per slot (places are then 2.3 instead of 1.6 mm
    off on a recorded drag, at about one and a half times the speed); `chunk` None fits the
    memory; `threshold` None is the method's own. `calibration`: a file of
    `Calibration.save`; `tare`: channels' zeros from contact-free slots, where there are;
    `policy`: a file of `save_policy`, whose slots alone are used, with its λ.

    **Example:**

    >>> import tomojax as tx
    >>> settings = tx.results.Settings(method="linear", rate="slot", contacts=1)
    >>> settings.pixels, settings.lam  # of a side of the image; None: the method's own λ
    (24, None)
    """

    method: str = "source"
    rate: Rate = "scan"
    images: bool = True
    lam: float | None = None
    grid: int | None = None
    contacts: int = 4
    threshold: float | None = None
    chunk: int | None = None  # scans
    calibration: str | None = None
    tare: bool = True
    policy: str | None = None

    @property
    def pixels(self) -> int:
        """Of a side of the image."""
        return self.grid or (24 if self.rate == "slot" else 32)

    def check(self) -> None:
        """**Raises:** `ValueError` naming the setting."""
        rates = ("slot", "scan")
        require(self.rate in rates, "rate", repr(self.rate), "'slot' or 'scan'")
        require(
            self.chunk is None or self.chunk > 0, "chunk", self.chunk, "scans, 1 or more"
        )
        apart = self.policy is None or self.rate == "scan"
        require(apart, "policy", "a row per slot", "rate 'scan'")
        lam = 1.0 if self.lam is None else self.lam
        check_limits(lam, self.contacts, self.threshold or 0.0)


def chunk_scans(recording: Recording, settings: Settings) -> int:
    """Scans of a chunk."""
    if settings.chunk:
        return settings.chunk
    slots = recording.slots
    # A row per slot has a group for each ground, which has to fill its blocks; a row per
    # scan has few, and a quarter of the memory does.
    scans = (CHUNK_SLOTS if settings.rate == "slot" else CHUNK_SLOTS // 4) // slots
    if settings.images:
        rows = slots if settings.rate == "slot" else 1
        scans = min(scans, _CHUNK_IMAGES // (4 * settings.pixels**2 * rows))
    return max(1, scans)
