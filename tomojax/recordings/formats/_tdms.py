"""Reads recordings of LabVIEW: one TDMS channel per electrode, in volts."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import open_container
from tomojax.recordings._described import number, rig_of, slots_of, whole_numbers
from tomojax.recordings._recording import check, PAPER, Recording, Scans


class TdmsRecording(Recording):
    """A group of channels with one value per slot.

    **Arguments** (the command line gives text): `group` of the channels;
    `channels`: names of the electrodes' channels with {} for the number, from 0, or
    {:02d} for 00, 01 and so on; `ground`: the
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
        fits = re.search(r"\{(:0[1-9]d)?\}", channels)
        require(fits, "channels", repr(channels), "a name with {} in it, or {:02d}")
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
        if len(lengths) > 1:  # the last segment lacks some channels' values
            told = f"{min(lengths)} of {max(lengths)} slots have all channels"
            self.mended = (f"the file is cut off: {told}",)
        properties: dict[str, Any] = self._file.attributes
        value = properties.get("slots_per_scan") if slots is None else slots
        require(value is not None, "slots", None, "the slots of a scan: slots=10")
        self.slots = slots_of(value)
        self.scans, rest = divmod(min(lengths), self.slots)
        if rest:
            self.mended += (f"the last {rest} slots make no whole scan and are left out",)
        paper = self.electrodes == 64
        require(paper, "channels", f"{self.electrodes} electrodes", "the paper's 64")
        rail = abs(number("rail", rail))
        told = {n: properties[n] for n in (*PAPER, "notes") if n in properties}
        told |= {"rows": 8, "columns": 8, "pitch": 0.02, "rails": (-rail, rail)}
        self.rig, said = rig_of(told, self.electrodes)
        self.mended += said
        check(self)
        self.interval = self.slots / self.rig.f_switch
        self.t0 = np.arange(self.scans) * self.slots / self.rig.f_switch

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
        shape = (stop - start, self.slots)
        ground = whole_numbers(ground).reshape(shape)
        return Scans(volts.reshape(*shape, -1), ground, self.t0[start:stop])

    def _named(self, channels: str) -> str:
        number = len(self._channels)
        return re.sub(r"\{.*?\}", lambda found: found[0].format(number), channels)

    def close(self) -> None:
        self._file.close()
