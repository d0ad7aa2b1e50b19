"""Lists pairs of electrodes: current enters and leaves by one, another is read."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from tomojax._require import require, require_whole

# No rig has as many electrodes.
_MOST = 1 << 12


@dataclass(frozen=True, eq=False)
class Pairs:
    """C conditions: an ampere from one electrode to another, and R readings of each.

    **Arguments:** `inject` (C, 2): the electrodes that current enters and leaves by;
    `read` (C, R, 2): the electrodes plus and minus of each reading.
    **Raises:** `ValueError` for shapes that disagree, and pairs of one electrode.

    **Example:**

    >>> import tomojax as tx
    >>> pairs = tx.ert.Pairs([[0, 2], [1, 3]], [[[1, 3]], [[2, 0]]])
    >>> pairs.conditions, pairs.readings
    (2, 1)
    """

    inject: Int[np.ndarray, "C 2"]
    read: Int[np.ndarray, "C R 2"]

    def __init__(self, inject: Any, read: Any):
        for name, value in (("inject", inject), ("read", read)):
            pairs = np.asarray(value)
            axes = "(conditions, 2)" if name == "inject" else "(conditions, readings, 2)"
            fits = pairs.ndim == axes.count(",") + 1 and pairs.shape[-1] == 2 and pairs.size
            require(fits, name, f"shape {pairs.shape}", axes)
            whole = (pairs == np.floor(pairs)) & (pairs >= 0) & (pairs < _MOST)
            require(whole.all(), name, pairs[~whole][:3], f"electrodes, 0 to {_MOST - 1}")
            same = np.argwhere(pairs[..., 0] == pairs[..., 1])
            told = f"one electrode twice at {same[:3].tolist()}"
            require(not len(same), name, told, "two electrodes")
            object.__setattr__(self, name, pairs.astype(int))
        count = len(self.inject)
        require(len(self.read) == count, "read", f"{len(self.read)} conditions", f"{count}")

    @property
    def conditions(self) -> int:
        """Returns the number of conditions, C."""
        return len(self.inject)

    @property
    def readings(self) -> int:
        """Returns the number of readings of a condition, R."""
        return self.read.shape[1]

    def within(self, electrodes: int) -> "Pairs":
        """Returns the pairs. **Raises:** `ValueError` for electrodes that are not there."""
        for name in ("inject", "read"):
            most = int(getattr(self, name).max())
            require(most < electrodes, name, f"electrode {most}", f"0 to {electrodes - 1}")
        return self

    @classmethod
    def skip(cls, electrodes: int, skipped: int, rotated: bool = False) -> "Pairs":
        """Lists the usual protocol: `skipped` electrodes lie between the driven ones.

        Each electrode drives once. Readings are between neighbours; those that share a
        driven electrode are left out. The first reading of each injection begins at
        electrode 0, or, where they are `rotated`, at the one that the current enters by.

        **Example:**

        >>> import tomojax as tx
        >>> pairs = tx.ert.Pairs.skip(8, 1)
        >>> pairs.inject[:2].tolist(), pairs.read[0].tolist()
        ([[0, 2], [1, 3]], [[4, 3], [5, 4], [6, 5], [7, 6]])
        """
        inject, read = _around(electrodes, skipped, rotated)
        apart = undriven(inject, read)
        return cls(inject, np.stack([each[some] for each, some in zip(read, apart)]))

    @classmethod
    def named(
        cls, name: str, electrodes: int, rotated: bool = False, driven: bool = False
    ) -> "Pairs":
        """Lists the protocol of a name: "adjacent", "opposite" or "skip n".

        **Arguments:** `rotated` as of `skip`; `driven`: readings at driven electrodes are
        listed as well, as many files have them.
        **Raises:** `ValueError` for another name.

        **Example:**

        >>> import tomojax as tx
        >>> tx.ert.Pairs.named("skip 2", 16).inject[0].tolist()
        [0, 3]
        >>> tx.ert.Pairs.named("adjacent", 16, driven=True).read.shape
        (16, 16, 2)
        """
        half = electrodes // 2 - 1
        words = {"adjacent": 0, "opposite": half} | {f"skip {n}": n for n in range(half)}
        expected = "'adjacent', 'opposite' or 'skip n'"
        require(name in words, "protocol", repr(name), expected)
        if driven:
            return cls(*_around(electrodes, words[name], rotated))
        return cls.skip(electrodes, words[name], rotated)

    @classmethod
    def adjacent(cls, electrodes: int) -> "Pairs":
        """Lists the protocol that drives neighbours.

        **Example:**

        >>> import tomojax as tx
        >>> tx.ert.Pairs.adjacent(16).read.shape
        (16, 13, 2)
        """
        return cls.skip(electrodes, 0)

    @classmethod
    def opposite(cls, electrodes: int) -> "Pairs":
        """Lists the protocol that drives electrodes half way round from each other.

        **Example:**

        >>> import tomojax as tx
        >>> pairs = tx.ert.Pairs.opposite(16)
        >>> pairs.inject[1].tolist(), pairs.read.shape
        ([1, 9], (16, 12, 2))
        """
        require_whole("electrodes", electrodes, 4, _MOST)
        return cls.skip(electrodes, electrodes // 2 - 1)

    def exchanged(self) -> Int[np.ndarray, "k 5"]:
        """Lists readings whose roles are exchanged in another condition.

        Such two readings are equal (reciprocity). A row has condition and reading of one,
        the same of the other, and the sign between them.

        **Example:**

        >>> import tomojax as tx
        >>> tx.ert.Pairs([[0, 2], [3, 1]], [[[1, 3]], [[2, 0]]]).exchanged().tolist()
        [[0, 0, 1, 0, 1]]
        """
        driven = np.broadcast_to(self.inject[:, None], self.read.shape)
        both = np.stack([driven, self.read], 2).reshape(-1, 2, 2)
        names = np.sort(both, -1) @ np.array([_MOST, 1])
        same = (names[:, None] == names[None, :, ::-1]).all(-1)
        one, other = np.nonzero(np.triu(same, 1))
        sign = np.sign(both[..., 1] - both[..., 0]).prod(-1)
        at = [*np.divmod(one, self.readings), *np.divmod(other, self.readings)]
        return np.stack([*at, sign[one] * sign[other]], 1)


def undriven(inject: Any, read: Any) -> Bool[np.ndarray, "C R"]:
    """Tells which readings are at no driven electrode: those that a protocol keeps."""
    return ~(read[..., None] == inject[:, None, None]).any((2, 3))


def _around(electrodes: int, skipped: int, rotated: bool) -> tuple[Any, Any]:
    """Returns injections all the way round, and all readings of neighbours of each."""
    require_whole("electrodes", electrodes, 4, _MOST)
    require_whole("skipped", skipped, 0)
    fits = skipped <= electrodes - 2
    require(fits, "skipped", f"{skipped} of {electrodes}", "two apart")
    each = np.arange(electrodes)
    inject = np.stack([each, (each + skipped + 1) % electrodes], 1)
    first = each + rotated * each[:, None]
    return inject, np.stack([first + 1, first], 2) % electrodes
