"""Defines the settings that decide the rows of a results file, beside the recording."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._environment import environment
from tomojax._require import require
from tomojax.calibration import tare
from tomojax.methods import AbstractMethod, check_grid, check_limits, frames_of, METHODS
from tomojax.recordings import CHUNK_SLOTS, Rate, read_chunk, Recording
from tomojax.sensor import Calibration

# Bytes of a chunk's images.
_CHUNK_IMAGES = 1 << 26

_SECONDS = 5.0  # of work that are lost at most when a run is stopped
_FOLLOW = 2e-4  # seconds that a slot costs `follow`

_MOVED = 0.2  # pitches that a film's contacts move at most: half of a candidate's error
_SPEED = 1.0  # of a fast hand, m/s
_LONGEST = 16  # rows of a film; more save little, as a film's first row is searched

# Films' programs take seconds to compile, which as many rows are worth.
_WORTH = 20_000

# Frames that λ is chosen from.
_LAMBDA_FRAMES = 8

# Settings that are files.
FILES = "calibration", "policy"

_CHOSEN: Any = None  # stands for a value that follows from the other settings


@dataclass(frozen=True)
class Settings:
    """The settings that decide the rows of a results file, beside the recording.

    `method` None is "auto", and "source" for a row per slot. `lam` None is the method's own
    choice from the first frames with a contact. `grid` None is 32 × 32 pixels, or 24 × 24
    for a row per slot. On a recorded drag, 24 × 24 pixels place contacts 2.3 mm off, not
    1.6 mm, at 1.5 times the speed. `chunk` None is some seconds of work that fit the
    memory; `threshold` None is the method's own. `calibration` is a file of
    `Calibration.save`. `tare` takes channels' zeros from contact-free slots, where there
    are any. `policy` is a file of `save_policy`, whose slots alone are used, with its λ.
    `films` tells whether a row may begin at the contacts of a row shortly before. `films`
    None is yes for a long recording whose rows follow each other closely. `adapt` follows
    zeros and gains that drift, see `tomojax.calibration.Adapter`.

    **Example:**

    >>> import tomojax as tx
    >>> settings = tx.results.Settings(method="linear", rate="slot", contacts=1)
    >>> settings.pixels, settings.lam  # of a side of the image; None: the method's own λ
    (24, None)
    """

    method: str = _CHOSEN
    rate: Rate = _CHOSEN
    images: bool = _CHOSEN
    lam: float | None = None
    grid: int | None = None
    contacts: int = 4
    threshold: float | None = None
    chunk: int | None = None  # scans
    calibration: str | None = None
    tare: bool = True
    policy: str | None = None
    films: bool | None = None
    adapt: bool = False

    def __post_init__(self):
        follows = self.method == "follow"
        chosen = {
            "method": default_method(self.rate),
            "rate": "slot" if follows else "scan",
            "images": not follows,
        }
        for name, value in chosen.items():
            if getattr(self, name) is _CHOSEN:
                object.__setattr__(self, name, value)  # nobody sets them later

    @property
    def pixels(self) -> int:
        """Returns the pixels along a side of the image."""
        return (24 if self.rate == "slot" else 32) if self.grid is None else self.grid

    @property
    def in_order(self) -> str:
        """Says why a row needs the rows before it; an empty text where no row does."""
        if self.method == "follow":
            return "follow goes from slot to slot"
        return "--adapt goes in order" if self.adapt else ""

    def check(self) -> None:
        """Checks the settings. **Raises:** `ValueError` naming the setting."""
        rates = ("slot", "scan")
        require(self.rate in rates, "rate", repr(self.rate), "'slot' or 'scan'")
        if self.method == "follow":
            slots = "'slot': follow goes from slot to slot"
            require(self.rate == "slot", "rate", repr(self.rate), slots)
            require(not self.images, "images", self.images, "none with follow")
            from tomojax.step import check_followed  # which other runs need not

            check_followed(self.contacts)
            for name in ("lam", "threshold", "policy"):
                given = getattr(self, name)
                require(given is None, name, given, "none with follow")
        some = self.chunk is None or self.chunk > 0
        require(some, "chunk", self.chunk, "scans, 1 or more")
        whole = not (self.adapt and self.policy)
        require(whole, "adapt", "with a policy", "all slots of each scan: no policy")
        apart = self.policy is None or self.rate == "scan"
        require(apart, "policy", "a row per slot", "rate 'scan'")
        lam = 1.0 if self.lam is None else self.lam
        check_grid(self.pixels)
        check_limits(lam, self.contacts, self.threshold or 0.0)


def default_method(rate: str | None) -> str:
    """Returns "auto"; "source" for a row per slot, where "auto" is too slow."""
    return "source" if rate == "slot" else "auto"


def film_rows(recording: Recording, settings: Settings) -> int:
    """Returns the rows of a film (see `Batch`); 1 where each row is fitted alone."""
    per_scan = recording.slots if settings.rate == "slot" else 1
    long = recording.scans * per_scan >= _WORTH
    asked = long if settings.films is None else settings.films
    able = getattr(METHODS.get(settings.method), "films", False)
    if not (asked and able) or settings.policy:
        return 1
    pitch = np.sqrt(np.prod(recording.rig.size) / recording.electrodes)
    seconds = _MOVED * pitch / _SPEED
    return int(np.clip(seconds * per_scan / recording.interval, 1, _LONGEST))


def chunk_scans(recording: Recording, settings: Settings) -> int:
    """Returns the scans of a chunk: whole films, so that no row depends on the chunks."""
    film = film_rows(recording, settings)
    return -(-_asked_or_fitting(recording, settings) // film) * film


def _asked_or_fitting(recording: Recording, settings: Settings) -> int:
    if settings.chunk:
        return settings.chunk
    slots = recording.slots
    fallback = _FOLLOW if settings.method == "follow" else 0.0
    each = getattr(METHODS.get(settings.method), "seconds_per_slot", fallback)
    costly = int(_SECONDS / each) if each else CHUNK_SLOTS
    # A row per slot has a group for each ground, which has to fill its blocks; a row per
    # scan has few, and a quarter of the memory does.
    most = CHUNK_SLOTS if settings.rate == "slot" else CHUNK_SLOTS // 4
    scans = min(most, costly) // slots
    if settings.images:
        rows = slots if settings.rate == "slot" else 1
        scans = min(scans, _CHUNK_IMAGES // (4 * settings.pixels**2 * rows))
    return max(1, scans)


def configuration(recording: Recording, settings: Settings, size: int, digest: str) -> dict:
    """Lists all that decides the rows: two runs with the same list make the same bytes."""
    given = {name: getattr(settings, name) for name in FILES}
    digests = {f"{n}_sha256": _digest(n, path) for n, path in given.items() if path}
    return {
        **asdict(settings),
        **digests,
        "grid": settings.pixels,
        "chunk": size,
        "scans": recording.scans,
        **({"stretch": list(recording.stretch)} if recording.stretch else {}),
        "recording_sha256": digest,
        "rig_sha256": _digest_of_rig(recording),
        "versions": environment(),
    }


def calibration_of(recording: Recording, settings: Settings) -> Calibration:
    """Loads the settings' calibration, with zeros that the recording itself may tell."""
    given = settings.calibration
    calibration = Calibration.load(given, recording.electrodes) if given else Calibration()
    return tare(recording, calibration) if settings.tare else calibration


def choose_lambda(
    recording: Recording,
    method: AbstractMethod,
    settings: Settings,
    calibration: Calibration,
) -> float:
    """Returns the settings' λ, or the method's choice from the first contact."""
    if settings.lam is not None:
        return settings.lam
    size = max(1, CHUNK_SLOTS // recording.slots)  # whatever the chunks are
    for start in range(0, recording.scans, size):
        chunk = read_chunk(recording, start, min(start + size, recording.scans))
        height = np.where(chunk.good, np.abs(chunk.voltages), 0).max((1, 2))
        # Not the edges of a contact, where it lasts for a part of the scan.
        own, given = float(method.threshold), settings.threshold
        least = own if given is None else given
        touched = (height > least) & (height >= height.max() / 2)
        if touched.any():
            volts = calibration.voltages(chunk.voltages[touched])
            grounds, good = chunk.grounds[touched], chunk.good[touched]
            return method.choose_lambda(
                frames_of(volts, grounds, good, most=_LAMBDA_FRAMES)
            )
    return method.choose_lambda([])


def _digest_of_rig(recording: Recording) -> str:
    """Digests the rig and the first scan: a rig may be described beside the recording."""
    first = recording.read(0, 1)
    told = [recording.slots, recording.gaps.tolist()]
    rig = recording.rig
    apart = "outline", "conditions"  # as files have them, where they are told
    told += [np.asarray(v).tolist() for name, v in vars(rig).items() if name not in apart]
    told += [rig.outline.attributes()] if rig.outline else []
    told += [table.tolist() for table in rig.tables().values()]
    digest = hashlib.sha256(json.dumps(told).encode())
    digest.update(np.ascontiguousarray(first.voltages).tobytes())
    return digest.hexdigest()


def _digest(name: str, path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(f"{path}: not a {name}: {error}") from None


def require_same(config: dict, attributes: dict, path: Path) -> None:
    """Refuses results that were begun with another `config`. **Raises:** `ValueError`."""
    own = "configuration" in attributes and "tracked" not in attributes
    require(own, f"{path}", "no results of reconstruct", "the file of a run to go on with")
    before = json.loads(attributes["configuration"])
    for name in sorted({*config, *before}):
        was, now = before.get(name), config.get(name)
        # A file counts by its content, wherever it lies.
        if was == now or (name in FILES and was and now):
            continue
        was, now = _shortened(was, now)
        raise ValueError(
            f"{path}: {name}: begun with {was}, now {now}; give the same, or --overwrite"
        )


def _shortened(was: Any, now: Any) -> list[Any]:
    """Keeps the differences of two tables, and the beginnings of digests."""
    both = was, now
    if isinstance(was, dict) and isinstance(now, dict):
        names = [name for name in now if was.get(name) != now[name]] or list(now)
        return [", ".join(f"{n} {table.get(n)}" for n in names) for table in both]
    return [v[:12] if isinstance(v, str) and len(v) == 64 else v for v in both]
