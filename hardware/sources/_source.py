"""The interface of every source of slots."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int


class Got(NamedTuple):
    """The values that come with a slot's codes."""

    ground: int  # what was grounded, whatever was asked for
    lost: int  # slots lost just before this one
    number: int  # of this slot since the start; lost ones count
    time: float  # of the rig's clock since its first slot, s
    arrived: float  # when its last byte was here, s of `time.perf_counter`


@dataclass
class Counters:
    """Counts of everything that a source has seen."""

    slots: int = 0  # given out
    lost: int = 0  # never came, or not sound
    bad: int = 0  # pieces of data that were no sound message
    late: int = 0  # slots that came after a later one, or twice: not given out
    early: int = 0  # slots from before the rig's description: not given out
    disconnects: int = 0
    restarts: int = 0  # the rig was switched off and on
    jumps: int = 0  # times that its slot numbers jumped
    clock: int = 0  # slots at which its clock fell or stood: told again by the recording

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


@dataclass
class Handed:
    """A wire on which all is in order, as a loop in C takes it over."""

    descriptor: int  # of the open line
    serial: bool  # whether messages are coded by COBS; else datagrams
    trusted: int  # lost slots that are believed without another sign
    next: int  # number that the next slot has
    number: int  # of the next slot since the start
    last: int  # the rig's clock at the last slot, µs
    origin: int  # of that clock, µs: times since it
    base: float  # s, added to times
    rest: bytes  # that came and are no message yet; datagrams behind their lengths
    # The channel of each electrode, the electrode of each ground line, and its line.
    maps: tuple[np.ndarray, np.ndarray, np.ndarray]


class SlotSource(ABC):
    """A rig's slots, one `read` each; a context that starts and stops the source.

    A source of one's own is a subclass that keeps these promises; `check_source` tries
    them. One thread calls all methods, `set_grounds` between reads.

    - **Units.** `electrodes` M, 1 to 256, and `counters` are known before `start`. `rate`
      (slots a second), `scale` and `offset` are known after `start` and stay: codes are
      int16, V = `scale`·code + `offset`.
    - **Clocks.** `Got.time` is the rig's clock, s, 0 at the first slot that came; the
      clock rises with each slot, by 1/`rate` for each number. `Got.arrived` is the
      `time.perf_counter()` of this machine at the slot's last byte.
    - **Numbers.** `Got.number` counts all slots since the start. A lost slot is counted
      too: the next slot's `lost` says how many are missing, and its number jumps by as
      many. A source never makes up a slot, repeats none and sorts none in later.
    - **Grounds.** `Got.ground` is the electrode that was grounded, whatever was asked for;
      a number beyond M − 1 says that none was. Such a slot is flagged. A source with a
      table of ground conditions tells rows of the table, `condition_count` of them.
    - **Arrays.** The caller owns `codes`. The source fills all M of them in place, and
      touches the array no more once `read` has returned.
    - **Time.** `read` returns within `timeout` and a little. `set_grounds` waits for
      nothing. `waiting` is 0 where no slot is here: the loop works on no slot that is
      older than the time of one slot while another waits behind it.
    - **Trouble.** A cut line or a silent rig is None until slots come again, counted in
      `counters.disconnects` and told as lost slots. `read` raises `EOFError` where the
      slots have an end, as those of a recording. `stop` can be called twice; after `start`
      slots come again.

    Raise `ValueError` for wrong arguments; `check_grounds` judges grounds.
    """

    electrodes: int
    rate: float
    scale: float
    offset: float
    counters: Counters
    _number = 0  # of the next slot

    @abstractmethod
    def start(self) -> None:
        """Starts the slots. **Raises:** `OSError` where there is no rig."""

    @abstractmethod
    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        """Reads the next slot into `codes`; returns None if none came within `timeout` s.

        **Raises:** `EOFError` if no more slots will come.
        """

    @abstractmethod
    def set_grounds(self, grounds: Sequence[int]) -> None:
        """Sets the ground conditions that are repeated in turn from now on.

        **Raises:** `ValueError` for electrodes that do not exist.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stops reading; can be called twice."""

    @property
    def condition_count(self) -> int:
        """Returns the number of ground conditions: M, or the rows of their table."""
        return self.electrodes

    @property
    def waiting(self) -> int:
        """Slots that have come and are not yet read."""
        return 0

    def _counted(self, ground: int, lost: int, time: float, arrived: float) -> Got:
        """Counts a slot that is given out, and the `lost` ones before it."""
        number = self._number + lost
        self._number = number + 1
        self.counters.slots += 1
        self.counters.lost += lost
        return Got(ground, lost, number, time, arrived)

    def hand_over(self) -> Handed | None:
        """Hands the line to a loop in C while all is in order; None where it cannot."""
        return None

    def take_back(self, handed: Handed, arrived: float, ground: int, asked: int) -> None:
        """Takes the line back: when the last slot came, its ground, and the one asked."""
        raise NotImplementedError("a source that hands its line over takes it back")

    def __enter__(self) -> "SlotSource":
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()
