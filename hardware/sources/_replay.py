"""A recording as a source of slots."""

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from tomojax._require import require
from tomojax.hardware.sources._frames import check_grounds
from tomojax.hardware.sources._source import Counters, Got, SlotSource
from tomojax.recordings import Recording

_CHUNK = 256  # scans


class ReplaySource(SlotSource):
    """The slots of a recording one by one, `speed` times as fast as they were measured.

    Without `speed`, slots come as fast as they are read. Each slot has the ground that was
    recorded, whatever ground is asked for.
    """

    def __init__(self, recording: Recording, speed: float | None = None):
        fits = speed is None or speed > 0
        require(fits, "speed", speed, "above 0, or None: as fast as possible")
        self._recording, self._speed = recording, speed
        self.rig = recording.rig
        self.electrodes, self.rate = recording.electrodes, recording.rig.f_switch
        low, high = recording.rig.rails
        if not np.isfinite([low, high]).all():
            high = 2 * abs(recording.rig.drive_voltage)
            low = -high
        self.scale = (high - low) / 65535
        self.offset = low + 32768 * self.scale
        self.counters = Counters()
        self._before = recording.lost_before()
        self._stopped = True

    def start(self) -> None:
        self._row = self._slot = self._number = 0
        self._chunk, self._first = None, 0
        self._began = time.perf_counter()
        self._stopped = False

    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        recording = self._recording
        if self._stopped or self._row >= recording.scans:
            raise EOFError(f"{recording.path}: no more slots")
        inside = self._row - self._first
        if self._chunk is None or inside >= len(self._chunk.voltages):
            self._chunk = recording.read(self._row, self._row + _CHUNK)
            self._first, inside = self._row, 0
            if self._row == 0:
                self._origin = float(self._chunk.t0[0])
        slot = self._slot
        when = float(self._chunk.t0[inside]) - self._origin + slot / self.rate
        if self._speed is not None and not self._due(when, timeout):
            return None
        volts = self._chunk.voltages[inside, slot]
        exact = np.rint((volts - self.offset) / self.scale)
        codes[:] = np.clip(exact, -32768, 32767)
        ground = int(self._chunk.grounds[inside, slot])
        lost = 0 if slot else int(self._before[self._row]) * recording.slots
        self._slot = (slot + 1) % recording.slots
        self._row += self._slot == 0
        return self._counted(ground, lost, when, time.perf_counter())

    def _due(self, when: float, timeout: float) -> bool:
        """Waits for a slot's time, no longer than `timeout`."""
        assert self._speed is not None
        left = self._began + when / self._speed - time.perf_counter()
        time.sleep(max(0, min(left, timeout)))
        return left <= timeout

    def set_grounds(self, grounds: Sequence[int]) -> None:
        check_grounds(grounds, self.condition_count)

    @property
    def condition_count(self) -> int:
        return self.rig.condition_count

    def stop(self) -> None:
        self._stopped = True
