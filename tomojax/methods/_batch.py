"""Applies a method to many scans, or slots, of any grounds: frames in, rows out."""

from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Bool, Float, Integer

from tomojax._require import require, require_kind, require_whole
from tomojax._stopping import stop_if_asked
from tomojax.kernels.flags import Flag
from tomojax.methods._contract import (
    AbstractMethod,
    Frame,
    grounded_of,
    inside_of,
    Part,
)
from tomojax.methods._doubts import look_at, Looked
from tomojax.methods._rows import empty_rows, Rows

# Calls that run side by side: the parts of one call are not all parallel.
_WORKERS = 2

# Fewer frames are not shared among them: each call has its costs.
_LEAST = 16

# Films of a part: a call has as many frames, of which each film has a first.
_FILMS = 128

# Ground sets whose preparation is kept: 2 MB each for 64 slots.
_KEPT = 128


class Batch:
    """A method at one λ, applied to frames; remembers its preparations.

    **Arguments:** `method` of `tomojax.method`; `lam` λ (the method's own choice by
    default); `contacts` C; `images` False leaves images out; `threshold`: volts that no
    channel exceeds without a contact (the method's own by default). `film` counts frames in
    a row that follow each other closely (1: none do). A method that `films` may begin all
    but the first where an earlier frame ended. `devices` share the frames (all of this
    process by default), by `jax.sharding` along the scan axis. A copy, and what another
    process gets by pickle, has all devices of its process.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = np.asarray(tx.voltages(sensor, touch, [0, 15]))
    >>> batch = tx.Batch(method, contacts=2)
    >>> rows = batch(volts[None], np.array([[0, 15]]))  # one frame of two slots
    >>> print(rows.contact_count, np.round(1e3 * rows.contact_xy[0, 0]))  # mm
    [1] [30. 50.]
    """

    def __init__(
        self,
        method: AbstractMethod,
        lam: float | None = None,
        contacts: int = 4,
        images: bool = True,
        threshold: float | None = None,
        devices: list[Any] | None = None,
        film: int = 1,
    ):
        require_kind("method", method, AbstractMethod)
        lam = method.choose_lambda([]) if lam is None else lam
        threshold = float(method.threshold) if threshold is None else threshold
        check_limits(lam, contacts, threshold)
        self.method, self.lam = method, float(lam)
        self.contacts, self.images, self.threshold = int(contacts), images, threshold
        self.devices = jax.local_devices() if devices is None else devices
        require(film >= 1, "film", film, "frames, 1 or more")
        self.film = film if method.films else 1
        self._prepared: OrderedDict[bytes, Any] = OrderedDict()
        self._begun = False
        self._grounded = grounded_of(method)
        self._about = float(method.drive_sign), float(method.noise), float(method.highest)

    def __getstate__(self) -> dict[str, Any]:
        """Leaves out what belongs to this process: devices, and what it has prepared."""
        return vars(self) | {"devices": [], "_prepared": OrderedDict(), "_begun": False}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, devices=jax.local_devices())

    def __call__(
        self,
        voltages: Float[np.ndarray, "n S M"],
        grounds: Integer[np.ndarray, "n S"],
        good: Bool[np.ndarray, "n S M"] | None = None,
        flags: Integer[np.ndarray, " n"] | None = None,
        lams: Float[np.ndarray, " n"] | None = None,
    ) -> Rows:
        """Returns rows of n frames; uses `good` voltages; adds to `flags` (bits).

        `lams`: λ of each frame, instead of one λ for all.

        A frame without a good voltage has no contact, NaN in image and residual, and the
        bit NO_DATA.

        **Raises:** `ValueError` for shapes that do not fit, and for NaN or a ground that is
        no electrode where `good` says to use them.
        """
        voltages, grounds = (np.asarray(a) for a in (voltages, grounds))
        of_type("voltages", voltages, "f", "volts: numbers with a point")
        of_type("grounds", grounds, "iu", "whole numbers")
        good = np.isfinite(voltages) if good is None else np.asarray(good)
        of_type("good", good, "b", "True or False")
        self._check(voltages, grounds, good)
        if lams is not None:
            lams = np.asarray(lams)
            fits = lams.shape == voltages.shape[:1] and bool((lams > 0).all())
            require(fits, "lams", f"shape {lams.shape}", "a λ above 0 for each frame")
        rows = self.empty(len(voltages))
        if flags is not None:
            told = np.shape(flags)
            require(told == rows.flags.shape, "flags", told, f"({len(rows.flags)},)")
            rows.flags[:] = flags
        grounds = np.where(good.any(2), grounds, 0)
        looked = look_at(voltages, grounds, good, *self._about, self._grounded)
        usable = self._nothing(voltages, good, looked, rows)
        keys = grounds * 0 if self.method.any_grounds else grounds
        apart = keys
        if lams is not None:
            kinds = np.unique(lams, return_inverse=True)[1]
            apart = np.concatenate([keys, kinds.reshape(-1, 1)], 1)
        groups = list(_groups(apart, good, np.flatnonzero(usable)))

        def of_frame(k: int) -> Any:
            lam = self.lam if lams is None else float(lams[k])
            return self._prepare(keys[k], good[k], lam)

        # What `jax.enable_x64` says here holds in this thread alone.
        wide = jax.config.jax_enable_x64  # pyright: ignore

        def work(job: tuple[Any, np.ndarray]) -> None:
            stop_if_asked()
            prepared, part = job
            with jax.enable_x64(wide):
                self._run(prepared, part, voltages, grounds, good, rows)

        for turn in self._turns([part for group in groups for part in self._parts(group)]):
            jobs = [(of_frame(int(part[0])), part) for part in turn]
            if len(jobs) == 1:
                work(jobs[0])
                continue
            with ThreadPoolExecutor(_WORKERS) as pool:
                list(pool.map(work, jobs))
        many = rows.contact_count > looked.most
        rows.flags[many] |= np.uint32(Flag.PLACE_UNCERTAIN)
        return rows

    def _turns(self, parts: list[np.ndarray]) -> list[list[np.ndarray]]:
        """Lists the parts that run side by side, turn by turn.

        The very first part runs alone: the program that it compiles serves the others. No
        turn has more parts than preparations are kept.
        """
        first = 0 if self._begun else 1
        self._begun = True
        return [[part] for part in parts[:first]] + _slices(parts[first:], _KEPT)

    def _parts(self, group: np.ndarray) -> list[np.ndarray]:
        """Splits a group into parts; a film stays whole."""
        if self.film == 1:
            return _slices(group, self._most(group))
        which = group // self.film // _FILMS
        return np.split(group, np.flatnonzero(np.diff(which)) + 1)

    def _most(self, group: np.ndarray) -> int:
        """Returns the frames of a part; workers share a group that no zeros fill up."""
        most, each = self.method.blocks[-1], -(-len(group) // _WORKERS)
        return most if self.method.padded else min(most, max(each, _LEAST))

    def _check(self, voltages, grounds, good) -> None:
        m = self.method.electrode_count
        shape = voltages.shape
        fits = len(shape) == 3 and shape[1] > 0 and shape[2] == m
        require(
            fits, "voltages", f"shape {shape}", f"(frames, slots, {m}), a slot at least"
        )
        require(grounds.shape == shape[:2], "grounds", grounds.shape, f"{shape[:2]}")
        require(good.shape == shape, "good", good.shape, f"{shape}")
        used = grounds[good.any(-1)]
        last = len(self._grounded) - 1
        inside = not used.size or (0 <= used.min() and used.max() <= last)
        require(inside, "grounds", "an electrode that is none", f"0 to {last} where good")
        finite = np.isfinite(voltages)
        require(finite.all() or finite[good].all(), "voltages", "NaN where good", "volts")

    def empty(self, n: int) -> Rows:
        """Makes rows of n frames that say nothing yet."""
        return empty_rows(n, self.method.sizes(self.contacts, self.images))

    def _nothing(
        self, voltages, good, looked: Looked, rows: Rows
    ) -> Bool[np.ndarray, " n"]:
        """Fills in rows without data or contact; marks the rows left for the method.

        This is the ladder's lowest step: no contact, image 0, all of the voltages left
        over.
        """
        used = voltages if good.all() else np.where(good, voltages, 0)
        data = looked.data
        quiet = data & (looked.height <= self.threshold)
        rows.flags[~data] |= np.uint32(Flag.NO_DATA)
        rows.flags[:] |= np.where(quiet, np.uint32(Flag.NO_CONTACT), looked.flags)
        squares = (used[quiet].astype(float) ** 2).sum((1, 2))
        rows.residual[quiet] = np.sqrt(squares / good[quiet].sum((1, 2)))
        inside = inside_of(self.method)
        nothing = 0.0 if inside is None else np.where(inside, 0.0, np.nan)
        if rows.image is not None and rows.residual_by_electrode is not None:
            rows.image[quiet] = nothing
            with np.errstate(invalid="ignore"):  # NaN where no slot is good
                mean = (used[quiet].astype(float) ** 2).sum(1) / good[quiet].sum(1)
            rows.residual_by_electrode[quiet] = np.sqrt(mean)
        for told in (rows.touch, rows.image_deviation):
            if told is not None:
                told[quiet] = nothing
        return data & ~quiet

    def _prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> Any:
        key = grounds.tobytes() + np.packbits(good).tobytes() + np.float64(lam).tobytes()
        if key not in self._prepared:
            self._prepared[key] = self.method.prepare(grounds, good, lam)
            if len(self._prepared) > _KEPT:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(key)
        return self._prepared[key]

    def _run(self, prepared, part, voltages, grounds, good, rows) -> None:
        size = len(part)
        if self.method.padded:
            size = next(b for b in self.method.blocks if b >= size)
        # A part of all frames has them in order. A copy under a mask takes longer, and few
        # parts need one.
        some, used = (a if len(part) == len(a) else a[part] for a in (voltages, good))
        some = some if used.all() else np.where(used, some, 0)
        block = np.zeros((size, *voltages.shape[1:]), self.method.cell.dtype)
        block[: len(part)] = some
        frames = Part(
            self._shared(jnp.asarray(block)),
            np.resize(grounds[part], (size, grounds.shape[1])),
            films=part // self.film if self.film > 1 else None,
        )
        found = self.method.block(prepared, frames, self.contacts, self.images)
        for name, values in found._asdict().items():
            if values is None:
                continue
            values = np.asarray(values)[: len(part)]
            if name == "flags":
                rows.flags[part] |= values.astype(np.uint32)
            else:
                getattr(rows, name)[part] = values

    def _shared(self, block: Array) -> Array:
        count = len(self.devices)
        if count == 1 or len(block) % count:
            return block
        mesh = Mesh(np.array(self.devices), ("scan",))
        return jax.device_put(block, NamedSharding(mesh, PartitionSpec("scan")))


def check_limits(lam: float, contacts: int, threshold: float) -> None:
    """Checks a `Batch`'s numbers. **Raises:** `ValueError` for numbers out of range."""
    require_whole("contacts", contacts, 1, 16)
    require(0 < _number(lam) < np.inf, "lam", lam, "a number above 0")
    fine = 0 <= _number(threshold) < np.inf
    require(fine, "threshold", threshold, "volts, 0 or more")


def _number(value: Any) -> float:
    return np.nan if isinstance(value, str) or np.ndim(value) else float(value)


def of_type(name: str, array: np.ndarray, kinds: str, expected: str) -> None:
    """Requires an array of one of NumPy's `kinds` of numbers. **Raises:** `ValueError`."""
    require(array.dtype.kind in kinds, name, f"{array.dtype} numbers", expected)


def _groups(grounds, good, usable) -> Iterator[np.ndarray]:
    """Groups frames with the same grounds and the same good channels."""
    if not len(usable):
        return
    mixed = good.reshape(len(good), -1).view(np.uint8)
    bad = ~good.all((1, 2))
    # Frames with bad channels are few: only those carry their mask into the key.
    masks = np.zeros(len(good), int)
    if bad.any():
        packed = np.packbits(mixed[bad], axis=1)
        masks[bad] = 1 + np.unique(packed, axis=0, return_inverse=True)[1].ravel()
    if grounds.shape[1] == 1:
        group = (grounds[usable, 0] * (masks.max() + 1) + masks[usable]).astype(np.int32)
    else:
        # Runs of equal keys first: a scan's pattern changes seldom, or not at all.
        keys = np.concatenate([grounds, masks[:, None]], 1)[usable]
        change = np.concatenate([[True], (keys[1:] != keys[:-1]).any(1)])
        starts = np.flatnonzero(change)
        _, which = np.unique(keys[starts], axis=0, return_inverse=True)
        group = np.repeat(which.ravel(), np.diff(np.append(starts, len(keys))))
    order = np.argsort(group, kind="stable")
    yield from np.split(usable[order], np.flatnonzero(np.diff(group[order])) + 1)


def _slices(items: Any, size: int) -> list[Any]:
    """Cuts items into slices of `size`; the last slice may be shorter."""
    return [items[k : k + size] for k in range(0, len(items), size)]


def frames_of(
    voltages: np.ndarray, grounds: np.ndarray, good: np.ndarray, most: int
) -> list[Frame]:
    """Picks up to `most` frames, spread evenly."""
    step = max(1, -(-len(voltages) // most))
    return [
        Frame(np.where(g, v, 0), np.where(g.any(1), ground, 0), g)
        for v, ground, g in zip(voltages[::step], grounds[::step], good[::step])
    ]
