"""A source that puts right a rig's wires that are in another order than its electrodes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from tomojax._require import require
from tomojax.hardware.sources._source import Got, Handed, SlotSource


class OrderedSource(SlotSource):
    """Another source's slots, as if the rig were wired right.

    **Arguments:** `channels`: the electrode that each channel reads; `grounds`: the
    electrode that each ground line switches, −1 where it switches none. None means that the
    wires are in order. `tomojax check --write` finds both.

    Codes come in the order of electrodes. Grounds are electrodes, both in slots and in
    commands. A slot without a ground comes with a ground number that no electrode has,
    which is flagged.
    """

    def __init__(
        self,
        source: SlotSource,
        channels: Sequence[int] | None = None,
        grounds: Sequence[int] | None = None,
    ):
        m = source.electrodes
        self._source, self.electrodes, self.counters = source, m, source.counters
        order = np.arange(m) if channels is None else np.asarray(channels, int)
        whole = order.shape == (m,) and (np.sort(order) == np.arange(m)).all()
        require(whole, "channels", f"{len(order)} of them", f"each of 0 to {m - 1} once")
        n = source.condition_count  # M, or the rows of a table
        lines = np.arange(n) if grounds is None else np.asarray(grounds, int)
        fits = lines.shape == (n,) and lines.min() >= -1 and lines.max() < n
        require(fits, "grounds", f"{len(lines)} of them", f"{n} of -1 to {n - 1}")
        self._back, self._lines = np.argsort(order), lines
        self._line = {int(e): g for g, e in reversed(list(enumerate(lines))) if e >= 0}
        self._codes = np.zeros(m, np.int16)

    @property
    def condition_count(self) -> int:
        return self._source.condition_count

    @property
    def waiting(self) -> int:
        return self._source.waiting

    def start(self) -> None:
        source = self._source
        source.start()
        self.rate, self.scale, self.offset = source.rate, source.scale, source.offset

    def stop(self) -> None:
        self._source.stop()

    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        got = self._source.read(self._codes, timeout)
        if got is None:
            return None
        np.take(self._codes, self._back, out=codes)
        inside = 0 <= got.ground < len(self._lines)
        ground = int(self._lines[got.ground]) if inside else got.ground
        return got._replace(ground=ground if ground >= 0 else min(len(self._lines), 255))

    def hand_over(self) -> Handed | None:
        n = len(self._lines)
        if len(self._line) < n:  # a ground that cannot be asked for is Python's to refuse
            return None
        handed = self._source.hand_over()
        line_of = np.array([self._line[e] for e in range(n)])
        maps = self._back, self._lines, line_of
        return None if handed is None else replace(handed, maps=maps)

    def take_back(self, handed: Handed, arrived: float, ground: int, asked: int) -> None:
        line, wanted = (self._line.get(e, -1) for e in (ground, asked))
        self._source.take_back(handed, arrived, line, wanted)

    def set_grounds(self, grounds: Sequence[int]) -> None:
        """Sets grounds, and leaves out electrodes that no line switches.

        **Raises:** `ValueError` if no electrode is left, or for electrodes that do not
        exist.
        """
        wanted = [int(e) for e in grounds]
        last = self.condition_count - 1
        inside = all(0 <= e <= last for e in wanted)
        require(inside, "grounds", wanted, f"0 to {last}")
        lines = [self._line[e] for e in wanted if e in self._line]
        require(bool(lines), "grounds", wanted, "electrodes that a line switches")
        self._source.set_grounds(lines)
