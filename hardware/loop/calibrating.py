"""Shows what a rub tells so far: a process that reads the ring and the growing file.

A map of the sheet's squares fills as the finger touches them. Meanwhile, calibrations of
the slots on the disk say how well each part is known.
"""

import json
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import SIDE, SlotRing
from tomojax.recordings import rig_of

_EVERY = 0.2  # s between looks
_SLOTS = 10  # that tell of a place together
_TOUCHED = 0.01  # volts that a contact exceeds, of the drive
_ENOUGH = 2  # visits that a square needs

_FRAMES = 120  # of the calibrations in between
_AGAIN = 10.0  # s from one of these to the next
_NICE = 10  # they give way to the loop and the recorder


class Map:
    """Counts of visits to each square of the sheet, a square about a pitch wide."""

    def __init__(self, rig: Any):
        self._drive, self._sensor = abs(rig.drive_voltage), rig.sensor()
        from tomojax.calibration import squares_touched

        self.count = squares_touched(self._sensor, np.zeros((0, 2)))
        size = np.asarray(rig.size)
        at = (rig.electrode_xy / size * self.count.shape).astype(int)
        self._square = np.clip(at, 0, np.array(self.count.shape) - 1)
        self._last = -1

    def add(self, volts: np.ndarray) -> None:
        """Adds slots in a row (n, M), V: the electrode that reads most marks its square."""
        n = len(volts) // _SLOTS
        each = volts[: n * _SLOTS].reshape(n, _SLOTS, -1)
        touched = np.abs(each).max(2).min(1) > _TOUCHED * self._drive
        for electrode in np.abs(each.sum(1)).argmax(1)[touched]:
            if electrode != self._last:
                self.count[tuple(self._square[electrode])] += 1
            self._last = electrode

    def image(self) -> np.ndarray:
        """Returns the squares as pixels, as large as fit."""
        shown = np.minimum(self.count, _ENOUGH) / _ENOUGH
        times = max(1, SIDE // max(shown.shape))
        return np.kron(shown, np.ones((times, times)))[:SIDE, :SIDE]

    def text(self) -> str:
        """Returns lines that say how many squares are touched, and where to rub more."""
        from tomojax.calibration import rub_more

        enough = int((self.count >= _ENOUGH).sum())
        lines = [f"{enough} of {self.count.size} squares touched"]
        return "\n".join(lines + rub_more(self._sensor, self.count))


class Known:
    """Calibrates the slots on the disk again and again, and says how well all is known."""

    def __init__(self, path: Path):
        self.text, self._path = "", path
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self) -> None:
        from tomojax.calibration import calibrated_recording, text
        from tomojax.recordings import open_recording

        while True:
            time.sleep(_AGAIN)
            try:
                with open_recording(self._path) as recording:
                    found = calibrated_recording(
                        recording, most=_FRAMES, progress=self._progress
                    )
                    told = text(recording.rig.sensor(), found).splitlines()
                lines = [line for line in told if not line.startswith("rub more")]
                self.text = "so far: " + "\n".join(lines)
            except (OSError, ValueError) as error:  # too little is there
                self.text = f"so far: {str(error).partition(';')[0]}"

    def _progress(self, text: str) -> None:
        if not self.text.startswith("so far"):
            self.text = f"calibrating what is there: {text}"


def watch(ring: SlotRing, told: dict[str, Any], path: Path) -> None:
    """Draws the map and prints the lines until the ring is done."""
    drawn, known = Map(rig_of(told)), Known(path)
    left = np.zeros((0, ring.electrodes))
    for rows, _ in ring.follow(_EVERY, 0):
        volts = rows["codes"] * told["scale"] + told["offset"]
        volts = np.concatenate([left, volts])
        whole = len(volts) // _SLOTS * _SLOTS
        drawn.add(volts[:whole])
        left = volts[whole:]
        image = drawn.image()
        ring.head["image"][: image.shape[0], : image.shape[1]] = image
        ring.say("\n".join(filter(None, (drawn.text(), known.text))))


def main() -> None:
    given = begun(__doc__, "ring", "told", "path", nice=_NICE)
    watch(SlotRing(given.ring), json.loads(given.told), Path(given.path))
    # A calibration that is still at work is for nothing now.
    os._exit(0)


if __name__ == "__main__":
    main()
