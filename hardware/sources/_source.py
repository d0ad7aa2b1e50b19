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


class SlotSource(ABC):
    """A rig's slots, one `read` each; a context that starts and stops the source.

    Codes are int16: V = `scale`·code + `offset`. These two and `rate` (slots a second) are
    known once the source is started. A gap is a number (`Got.lost`), never a made-up slot.
    """

    electrodes: int
    rate: float
    scale: float
    offset: float
    counters: Counters

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
    def waiting(self) -> int:
        """Slots that have come and are not yet read."""
        return 0

    def __enter__(self) -> "SlotSource":
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()
