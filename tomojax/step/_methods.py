"""Computes contacts from a slot: follows them between slots, or sees each slot alone."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import (
    Contacts,
    no_contacts,
    points_image,
    Spots,
    strongest_first,
)
from tomojax.methods import (
    AbstractMethod,
    bits_of,
    centred,
    Estimate,
    grounded_of,
    masked,
    Points,
    rms,
)
from tomojax.step._state import Read, Slot

# One more contact may hide where more than this part of a slot's spread of voltages is
# left: nineteen in twenty lone ones leave 2.5 % at most, or 6 % on a sheet with a gradient
# of a fifth.
_LIMIT = 0.05

# Highest voltage, in the converter's noise, that places a contact: zeros that a slot shares
# with the next do not average out.
_FAINT = 10.0

# A place's covariance is so many times the filter's, to which slots' errors are independent
# and the sheet's waves few.
_FILTERED = 2.0

# And so many times what one slot tells, as slots share errors.
_SHARED = 1.0

# χ² of a channel that contacts leave, usually.
_LEFT = 0.65


class Told(NamedTuple):
    """The results of one slot."""

    contacts: Contacts
    residual: Float[Array, ""]  # V rms
    flags: Int[Array, ""]


class AbstractStepMethod(eqx.Module):
    """A method of a step: finds contacts slot by slot, with a memory of earlier slots."""

    count: eqx.AbstractVar[int]  # contacts at most
    # As of `AbstractMethod`.
    grounded: eqx.AbstractVar[Bool[np.ndarray, "L M"]]
    residual_limit: eqx.AbstractVar[float]
    noise: eqx.AbstractVar[Float[Array, ""]]

    @abstractmethod
    def image(self, memory: Any, slot: Slot) -> Float[Array, "nx ny"]:
        """Computes the image of a slot seen before, in the method's unit."""

    @abstractmethod
    def first(self) -> Any:
        """Returns the memory before the first slot."""

    @abstractmethod
    def __call__(self, memory: Any, read: Read) -> tuple[Any, Told]:
        """Returns the memory after a slot, and the slot's results."""


class Follow(AbstractStepMethod):
    """`points` carried on from slot to slot: see `kernels._follow`."""

    count: int = eqx.field(static=True)
    grounded: Bool[np.ndarray, "L M"]
    residual_limit: float
    noise: Float[Array, ""]
    points: Points
    candidates: model.Candidates
    errors: model.Noise
    slot_time: Float[Array, ""]  # s

    @classmethod
    def of(
        cls,
        points: Points,
        count: int,
        good: Bool[np.ndarray, " M"],
        f_switch: float = 10e3,
    ) -> "Follow":
        """Makes `follow` for `count` contacts, `good` channels and `f_switch` slots/s."""
        candidates = _candidates(points.sheet, points.candidates)
        errors, dtype = points.errors.in_slot(good), points.cell.dtype
        slot_time = jnp.asarray(1 / f_switch, dtype)
        # The limit is of all that is read; `__call__` judges by less.
        told = points.grounded, 1.0, errors.converter
        return cls(count, *told, points, candidates, errors, slot_time)

    def first(self) -> model.Followed:
        return model.nothing_followed(self.points.sheet.field.size, self.count)

    def __call__(self, memory: model.Followed, read: Read) -> tuple[model.Followed, Told]:
        sheet, voltages, ground = self.points.sheet, read.voltages, read.ground
        elapsed = read.elapsed * self.slot_time
        now, rest = model.follow(
            sheet,
            self.candidates,
            memory,
            voltages,
            read.used,
            ground,
            elapsed,
            self.errors,
        )
        used = read.used & ~sheet.slots.grounded(ground)
        residual = rms(rest, used)
        high = residual > _LIMIT * rms(centred(voltages, used), used) + 2 * self.noise
        radius = model.radius_of(sheet, now.size)
        unusual = jnp.maximum(1, now.left / _LEFT)
        c = unusual * (_FILTERED * now.covariance + _SHARED * now.alone) * sheet.unit**2
        found = Contacts(
            count=jnp.zeros((), jnp.uint8),
            xy=now.place,
            radius=radius,
            angle=jnp.full_like(radius, jnp.nan),
            current=now.current,
            conductance=now.conductance,
            covariance=jnp.stack([c[:, 0, 0], c[:, 1, 1], c[:, 0, 1]], 1),
        )
        faint = (jnp.abs(voltages).max() < _FAINT * self.noise) & now.there.any()
        vague = now.there & model.hardly_told(
            sheet, now.conductance, now.covariance[:, 2, 2]
        )
        flags = bits_of(
            (faint, Flag.PLACE_UNCERTAIN),
            (vague.any(), Flag.CONDUCTANCE_UNCERTAIN),
            (high, Flag.HIGH_RESIDUAL),
        )
        return now, Told(strongest_first(found, now.there), residual, flags)

    def image(self, memory: model.Followed, slot: Slot) -> Float[Array, "nx ny"]:
        none = jnp.zeros_like(memory.place)
        radius = model.radius_of(self.points.sheet, memory.size)
        current = jnp.where(memory.there, memory.current, 0)
        spots = Spots(memory.place, none, none[:, 0], radius, current)
        image = points_image(spots, self.points.cell, self.points.shape)
        return masked(self.points, image)


@jax.jit
def _candidates(sheet: model.Sheet, places: Float[Array, "K 2"]) -> model.Candidates:
    """Computes the voltages of usual contacts at these places."""
    none = jnp.zeros((), places.dtype)
    tangent = jax.vmap(model.tangents, (None, 0, None))(sheet, places, none)
    potential = tangent[:, 0]
    return model.Candidates(places, potential.T, potential.T**2, tangent)


class EachSlot(AbstractStepMethod):
    """A method of the ladder on each slot alone, without a memory."""

    count: int = eqx.field(static=True)
    grounded: Bool[np.ndarray, "L M"]
    residual_limit: float
    noise: Float[Array, ""]
    method: AbstractMethod
    prepared: Any  # of each ground
    shared: tuple[bool, ...] = eqx.field(static=True)  # whether all grounds share an array
    good: Bool[Array, " M"]

    @classmethod
    def of(
        cls, method: AbstractMethod, count: int, good: Bool[np.ndarray, " M"], lam: float
    ) -> "EachSlot":
        """Prepares the method for every ground, with the channels that are `good`."""
        grounded = grounded_of(method)
        each = method.prepare_each(good, lam)
        leaves = zip(*map(jax.tree.leaves, each))
        shared = tuple(all(one is some[0] for one in some) for some in leaves)
        both = iter(shared)
        prepared = jax.tree.map(
            lambda *a: a[0] if next(both) else jnp.asarray(np.stack(a)), *each
        )
        told = grounded, method.residual_limit, method.noise
        return cls(count, *told, method, prepared, shared, jnp.asarray(good))

    def first(self) -> tuple:
        return ()

    def __call__(self, memory: tuple, read: Read) -> tuple[tuple, Told]:
        estimate = self._estimate(read.voltages, read.ground)
        # It was prepared for the good channels: with one of them missing it says nothing.
        whole = (read.used | ~self.good).all()
        touched = jnp.abs(read.voltages).max() > self.method.threshold
        none = no_contacts(self.count, read.voltages.dtype)
        contacts = tree_where(whole & touched, estimate.contacts, none)
        flags = jnp.asarray(estimate.flags | bits_of((~whole, Flag.NO_DATA)), int)
        return (), Told(contacts, estimate.residual, flags)

    def image(self, memory: tuple, slot: Slot) -> Float[Array, "nx ny"]:
        image = self._estimate(slot.voltages, slot.ground).image
        return masked(self.method, image)

    def _estimate(self, voltages: Float[Array, " M"], ground: Int[Array, ""]) -> Estimate:
        leaves, tree = jax.tree.flatten(self.prepared)
        own = [a if shared else a[ground] for a, shared in zip(leaves, self.shared)]
        prepared = jax.tree.unflatten(tree, own)
        return self.method.estimate(prepared, voltages[None], self.count)
