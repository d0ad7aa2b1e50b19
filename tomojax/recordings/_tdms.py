"""Reads recordings of LabVIEW: one TDMS channel per electrode, in volts."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import open_container
from tomojax.recordings._recording import check, PAPER, Recording, Rig, Scans

_MOST_SLOTS = 1 << 16


class TdmsRecording(Recording):
    """A group of channels with one value per slot.

    **Arguments** (the command line gives text): `group` of the channels;
    `channels`: names of the electrodes' channels with {} for the number; `ground`: the
    channel of ground numbers; `slots`: per scan, by default the file's property
    `slots_per_scan`; `rail`: the converter's range ±V. File properties with the names of
    recording version 1's attributes describe the rig. The paper's rig stands for missing
    properties: 64 electrodes of 5 mm on 160 mm × 160 mm.
    """

    def __init__(
        self,
        path: Path,
        group: str = "scan",
        channels: str = "ai{}",
        ground: str = "ground",
        slots: int | str | None = None,
        rail: float | str = 5.0,
    ):
        self.path = path
        require("{}" in channels, "channels", repr(channels), "a name with {} in it")
        with path.open("rb") as raw:
            require(raw.read(4) == b"TDSm", "file", "no TDMS file", "a recording in TDMS")
        try:
            self._file = open_container(path, "tdms")
        except (ValueError, OSError) as error:
            raise ValueError(f"file: cannot be read as TDMS ({error})") from None
        try:
            self._load(group, channels, ground, slots, rail)
        except BaseException:
            self._file.close()
            raise

    def _load(self, group, channels, ground, slots, rail) -> None:
        groups = sorted({name.partition("/")[0] for name in self._file.names})
        require(group in groups, "group", repr(group), f"one of {groups[:20]}")
        known = set(self._file.names)
        self._channels = []
        while (name := f"{group}/{self._named(channels)}") in known:
            self._channels.append(name)
        self.electrodes = len(self._channels)
        found = sorted(n.partition("/")[2] for n in known if n.startswith(f"{group}/"))
        require(self.electrodes, "channels", f"only {found[:5]}", self._named(channels))
        require(ground in found, "ground", f"no {ground!r} in {group!r}", "this channel")
        self._ground = f"{group}/{ground}"
        lengths = {self._file.shape(n)[0] for n in (*self._channels, self._ground)}
        require(len(lengths) == 1, "channels", f"lengths {sorted(lengths)}", "one length")
        properties: dict[str, Any] = self._file.attributes
        value = properties.get("slots_per_scan") if slots is None else slots
        require(value is not None, "slots", None, "the slots of a scan: slots=10")
        slots_of = _number("slots", value)
        whole = 1 <= slots_of <= _MOST_SLOTS and slots_of == int(slots_of)
        require(whole, "slots", value, f"a whole number up to {_MOST_SLOTS}")
        self.slots = int(slots_of)
        self.scans, rest = divmod(lengths.pop(), self.slots)
        if rest:
            self.mended = (f"the last {rest} slots make no whole scan and are left out",)
        self.gaps = np.zeros((0, 2), int)
        rail = abs(_number("rail", rail))
        numbers = {n: _number(n, properties.get(n, d)) for n, d in PAPER.items()}
        taken = ", ".join(f"{n} {d:g}" for n, d in PAPER.items() if n not in properties)
        if taken:
            said = f"the file does not say, the paper's is taken: {taken}"
            self.mended = (*self.mended, said)
        index = np.indices((8, 8)).reshape(2, -1).T
        paper = self.electrodes == len(index)
        require(paper, "channels", f"{self.electrodes} electrodes", "the paper's 64")
        self.rig = Rig(
            size=(0.16, 0.16),
            electrode_xy=0.01 + 0.02 * index,
            # A step inside, as rounding of the codes may leave it.
            rails=(-rail * (1 - 1e-4), rail * (1 - 1e-4)),
            notes=str(properties.get("notes", "")),
            **numbers,
        )
        check(self)

    def read(self, start: int, stop: int) -> Scans:
        stop = min(stop, self.scans)
        offset, length = start * self.slots, (stop - start) * self.slots
        volts = np.empty((length, self.electrodes), np.float32)
        try:
            ground = self._file.read(self._ground, offset, offset + length)
            for e, channel in enumerate(self._channels):
                volts[:, e] = self._file.read(channel, offset, offset + length)
        except OSError as error:
            told = f"scans {start} to {stop} cannot be read ({error})"
            raise ValueError(
                f"{self.path}: channels: {told}; copy the file again"
            ) from None
        fine = np.isfinite(ground) & (np.abs(ground) < 2**31)
        ground = np.where(fine, ground, -1)  # no electrode's number: told as a fault
        shape = (stop - start, self.slots)
        t0 = self.start_times()[start:stop]
        return Scans(volts.reshape(*shape, -1), ground.reshape(shape).astype(int), t0)

    def start_times(self) -> np.ndarray:
        return np.arange(self.scans) * self.slots / self.rig.f_switch

    def _named(self, channels: str) -> str:
        return channels.replace("{}", str(len(self._channels)))

    def close(self) -> None:
        self._file.close()


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {value!r}, expected a number") from None
