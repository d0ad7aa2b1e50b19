"""The arithmetic of a step, from a state and a slot to the next state, to be compiled."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import Contacts, no_contacts
from tomojax.kernels.levels import level_bits
from tomojax.methods import bits_of, judge
from tomojax.paper import exploration
from tomojax.sensor import Calibration, Sensor
from tomojax.step._methods import AbstractStepMethod, Told
from tomojax.step._one_function import one_function
from tomojax.step._packing import Packed, Packing
from tomojax.step._policies import AbstractPolicy, Plan, Seen
from tomojax.step._state import About, Doubt, Output, Read, Remembered, silent, Slot


class Traced:
    """A method and a policy as pure functions of packed arrays, and JAX's programs of them.

    All that belongs to a rig is an array: C that is written for one rig serves every rig
    with arrays of the same shapes.
    """

    def __init__(
        self,
        sensor: Sensor,
        method: AbstractStepMethod,
        cheaper: AbstractStepMethod | None,
        policies: dict[str, AbstractPolicy],
        good: Bool[np.ndarray, " M"],
        highest: float,
        calibration: Calibration,
    ):
        self.sensor = sensor
        self.electrode_count = m = sensor.electrode_count
        self.condition_count = sensor.condition_count
        self.names = tuple(policies)
        self.dtype = np.dtype(sensor.dtype)
        self._method, self._cheaper = method, cheaper
        self._grounded = jnp.asarray(method.grounded)
        self._policies = tuple(policies.values())
        self._corners = exploration(sensor).astype(jnp.int32)
        self._good = jnp.asarray(good)
        self._highest = jnp.asarray(highest, self.dtype)
        self._drive_sign = jnp.asarray(np.sign(sensor.drive_voltage), self.dtype)
        zero, gain = calibration.offset, calibration.gain
        self._zero, self._gain = (
            jnp.asarray(np.broadcast_to(a, m), self.dtype) for a in (zero, gain)
        )
        self.traces = 0
        self.contact_count = method.count
        self.packing = Packing(jax.eval_shape(self._begun), self.dtype)
        self.said = Packing(
            jax.eval_shape(lambda: silent(method.count, self.dtype)), self.dtype
        )
        # One program for all of it: each operation by itself would be one to compile.
        self.state: Packed = jax.jit(lambda: self.packing.pack(self._begun()))()

    @cached_property
    def about(self) -> About:
        """The facts that a step's face needs."""
        numbers, whole = (np.arange(a.size, dtype=a.dtype) for a in self.state)
        plan = self.packing.unpack((numbers, whole)).plan
        return About(
            self.electrode_count,
            self.condition_count,
            self.contact_count,
            self.names,
            str(self.dtype),
            type(getattr(self._method, "method", self._method)).__name__,
            int(plan.policy),
            int(plan.length),
            int(plan.grounds[0]),
            tuple(jax.eval_shape(self.draw, self.state).shape),
            float(self.sensor.drive_voltage),
        )

    @property
    def zero_and_gain(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns what the rig's readings are taken to have: V, and a factor."""
        return np.asarray(self._zero), np.asarray(self._gain)

    @property
    def slot(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns a slot's arrays, as a program takes them."""
        return np.zeros(self.electrode_count, self.dtype), np.zeros(3, np.int32)

    @cached_property
    def _each(self) -> Callable:
        return one_function(self.run)

    @cached_property
    def compiled(self) -> Callable:
        """JAX's program of one slot."""
        return jax.jit(self._each).lower(self.state, *self.slot).compile()

    @cached_property
    def replayed(self) -> Callable:
        """JAX's program of a block of slots."""
        return jax.jit(self._replayed)

    @cached_property
    def drawn(self) -> Callable:
        """JAX's program of an image."""
        return jax.jit(self.draw)

    def _begun(self) -> Remembered:
        """Returns the memory before the first slot: the corners are next."""
        m, no = self.electrode_count, jnp.array(False)
        none = jnp.zeros((), jnp.int32)
        plan = Plan(
            policy=none,
            grounds=self._no_grounds().at[:2].set(self._corners),
            length=none + 2,
            at=none,
            exploring=jnp.array(True),
            explored=jnp.zeros((2, m), self.dtype),
        )
        return Remembered(
            memory=self._method.first(),
            cheaper=() if self._cheaper is None else self._cheaper.first(),
            plan=plan,
            doubt=Doubt(stretch=no, held=none, full=no),
            last=Slot(jnp.zeros(m, self.dtype), ground=none, lost=none, hurried=no),
            used=jnp.zeros(m, bool),
        )

    def _no_grounds(self) -> Int[Array, " n"]:
        """Returns room for a stretch of any ground conditions."""
        return jnp.zeros(max(2, *self._grounded.shape), jnp.int32)

    def run(self, state: Packed, volts: Array, whole: Array) -> tuple[Packed, Packed]:
        """Runs one slot."""
        self.traces += 1
        slot = Slot(volts, whole[0], whole[1], whole[2] > 0)
        remembered, said = self._run(self.packing.unpack(state), slot)
        return self.packing.pack(remembered), self.said.pack(said)

    def _replayed(self, state: Packed, volts: Array, whole: Array, count: Array) -> tuple:
        """Runs the first `count` slots; the outputs of the other slots are 0."""
        none = self.said.pack(silent(self.contact_count, self.dtype))
        said = jax.tree.map(lambda a: jnp.zeros((len(volts), *a.shape), a.dtype), none)

        def turn(k: Array, carry: tuple) -> tuple:
            state, said = carry
            state, new = self._each(state, volts[k], whole[k])
            return state, jax.tree.map(lambda a, b: a.at[k].set(b), said, new)

        return lax.fori_loop(0, count, turn, (state, said))

    def _run(self, state: Remembered, slot: Slot) -> tuple[Remembered, Output]:
        read = self._checked(slot)
        memory, cheaper, told = self._told(state, slot, read)
        contacts, bits = self._judged(told, read)
        doubt, doubted = self._doubted(state.doubt, contacts, bits, read.ok)
        seen = Seen(
            explored=self._explored(state.plan, slot, read),
            contacts=contacts,
            doubted=doubt.stretch,
            ground=read.ground,
            conditions=self.condition_count,
        )
        plan, over = self._planned(state.plan, seen)
        more = bits_of(
            (slot.hurried & (self._cheaper is not None), Flag.HURRIED),
            (~read.ok, Flag.NO_DATA),
            (doubted & read.ok, Flag.HIGH_RESIDUAL),
        )
        residual: Array = jnp.where(read.ok, told.residual, jnp.nan)
        flags = read.flags | bits | more
        output = Output(contacts, residual, flags, plan.grounds[plan.at])
        kept = state.memory, state.cheaper
        memory, cheaper = tree_where(read.ok, (memory, cheaper), kept)
        doubt = doubt._replace(stretch=doubt.stretch & ~over)
        last = Slot(read.voltages, read.ground, slot.lost, slot.hurried)
        used = read.used & read.ok
        return Remembered(memory, cheaper, plan, doubt, last, used), output

    def _checked(self, slot: Slot) -> Read:
        """Corrects the voltages, and tells which channels can be used."""
        finite = jnp.isfinite(slot.voltages)
        volts: Array = slot.voltages
        size: Array = jnp.where(finite, jnp.abs(volts), 0)
        high = size > self._highest
        used = self._good & finite & ~high
        voltages: Array = jnp.where(used, (volts - self._zero) / self._gain, 0)
        grounds = len(self._grounded)
        known = (slot.ground >= 0) & (slot.ground < grounds)
        enough = 2 * used.sum() >= self._good.sum()
        flags = bits_of(
            ((self._good & ~finite).any(), Flag.BAD_VOLTAGES),
            ((self._good & high).any(), Flag.SATURATED),
            (~known, Flag.UNKNOWN_GROUND),
            (slot.lost > 0, Flag.GAP),
            (finite.all() & (size == 0).all(), Flag.ALL_ZERO),
        )
        ground = jnp.clip(slot.ground, 0, grounds - 1).astype(jnp.int32)
        against = jnp.where(known, self._against(voltages, used, ground), 0)
        return Read(
            voltages,
            used,
            ground,
            elapsed=(1 + jnp.maximum(slot.lost, 0)).astype(voltages.dtype),
            ok=known & enough,
            flags=flags | against,
        )

    def _against(self, voltages: Array, used: Array, ground: Array) -> Int[Array, ""]:
        """Flags levels that cannot be, see `level_bits`."""
        towards: Array = voltages * self._drive_sign
        high = jnp.where(used, towards, -jnp.inf).max()
        low = jnp.where(used, towards, jnp.inf).min()
        held = self._grounded[ground] & used
        at = jnp.where(held, towards, jnp.inf).min()
        at = jnp.where(held.any(), at, -jnp.inf)
        bits = level_bits(low, high, at, self._method.noise, jnp)
        return jnp.asarray(bits, jnp.int32)

    def _told(self, state: Remembered, slot: Slot, read: Read) -> tuple[Any, Any, Told]:
        """Returns both methods' memories after the slot, and the slot's results."""
        if self._cheaper is None:
            memory, told = self._method(state.memory, read)
            return memory, (), told
        # The cheaper one goes along, so that it can answer at any time.
        cheaper, quick = self._cheaper(state.cheaper, read)
        memory, told = lax.cond(
            slot.hurried,
            lambda: (state.memory, quick),
            lambda: self._method(state.memory, read),
        )
        return memory, cheaper, told

    def _judged(self, told: Told, read: Read) -> tuple[Contacts, Array]:
        """Returns contacts and flags; an unusable slot has no contact and no flag."""
        contacts, residual, bits = told
        limit, noise = self._method.residual_limit, self._method.noise
        contacts, bits = judge(contacts, residual, bits, read.voltages, limit, noise)
        none = no_contacts(len(contacts.radius), read.voltages.dtype)
        bits = bits.astype(jnp.int32)
        return tree_where(read.ok, (contacts, bits), (none, jnp.zeros_like(bits)))

    def _doubted(
        self, doubt: Doubt, contacts: Contacts, bits: Array, ok: Array
    ) -> tuple[Doubt, Array]:
        """Returns the doubt after a slot, and whether the slot is flagged with the doubt.

        Some slots of a stretch see a hidden contact, others do not: one slot's doubt holds
        for all. The doubt holds for longer while every contact place is
        taken. The last contact to come explains doubts that came before it, or with it.
        """
        high = (bits & Flag.HIGH_RESIDUAL.value) > 0
        full = contacts.count == len(contacts.radius)
        left = jnp.maximum(doubt.held - ok.astype(jnp.int32), 0)
        held = jnp.where(high & full & doubt.full, self.electrode_count // 2, left)
        stretch = doubt.stretch | high
        return Doubt(stretch, held, full), stretch | (full & (held > 0))

    def _explored(self, plan: Plan, slot: Slot, read: Read) -> Array:
        corner = (slot.ground == self._corners) & read.ok
        return jnp.where(corner[:, None], read.voltages, plan.explored)

    def _planned(self, plan: Plan, seen: Seen) -> tuple[Plan, Array]:
        """Returns the plan for the next slot, and whether a new stretch begins there."""
        at, room = plan.at + 1, self._no_grounds()
        corners = room.at[:2].set(self._corners)

        def laid(policy: AbstractPolicy) -> tuple:
            grounds = policy(seen).astype(jnp.int32)
            whole = room.at[: len(grounds)].set(grounds)
            return whole, jnp.array(len(grounds), jnp.int32), jnp.array(False)

        def next_of(policy: AbstractPolicy) -> Any:
            if not policy.explores:
                return lambda: laid(policy)
            explore = corners, jnp.array(2, jnp.int32), jnp.array(True)
            return lambda: lax.cond(
                plan.exploring & (plan.length > 0), lambda: laid(policy), lambda: explore
            )

        branches = [next_of(policy) for policy in self._policies]
        same = lambda: (plan.grounds, plan.length, plan.exploring)  # noqa: E731
        anew = lambda: lax.switch(plan.policy, branches)  # noqa: E731
        over = at >= plan.length
        grounds, length, exploring = lax.cond(over, anew, same)
        at = jnp.where(over, 0, at)
        return Plan(plan.policy, grounds, length, at, exploring, seen.explored), over

    def draw(self, state: Packed) -> Float[Array, "nx ny"]:
        remembered = self.packing.unpack(state)
        image = self._method.image(remembered.memory, remembered.last)
        return jnp.where(remembered.used.any(), image, jnp.nan)
