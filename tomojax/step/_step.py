"""The step of a robot: one slot in, contacts and the next ground out, compiled once."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax._require import require
from tomojax._shown import named
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import Contacts, no_contacts
from tomojax.kernels.levels import level_bits
from tomojax.methods import bits_of, judge
from tomojax.paper import exploration
from tomojax.sensor import Calibration, Sensor
from tomojax.step._methods import AbstractStepMethod, Told
from tomojax.step._one_function import one_function
from tomojax.step._packing import Packed, packed, Packing, State
from tomojax.step._policies import AbstractPolicy, Plan, Seen
from tomojax.step._saving import load_state, save_state
from tomojax.step._state import Doubt, Output, Read, Remembered, Slot

# Slots of a compiled call of `replay`: a tenth of a second of work, 1 MB.
_BLOCK = 4096


class Step:
    """A method and a policy as one compiled function of a state and a slot.

    `state` is the first state: two arrays, which `save` and `load` keep in a file.
    `step(state, voltages, ground)` gives the state after that slot and an `Output` in
    NumPy's arrays. The input is converted and checked for its shape. Nothing else in the
    input can raise or compile anew: flags tell of wrong input. `replay` runs recorded slots
    in one compiled loop. `image(state)` gives the image after a slot, on request.
    `make_step` makes a step.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])
    >>> step = tx.make_step(sensor, "source", ["boundary", "all"], contacts=1, grid=8)
    >>> state = step.switch(step.state, "all")
    >>> state, out = step(state, volts[0], 0)
    >>> step.policies, step.image(state).shape
    (('boundary', 'all'), (8, 8))
    >>> step.save("state.npz", state)
    >>> state, out = step(step.load("state.npz"), volts[1], 15)  # goes on
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
        self._made_of = sensor, method, cheaper, policies, good, highest, calibration
        self.electrode_count = sensor.electrode_count
        self.condition_count = sensor.condition_count
        self.policies = tuple(policies)
        self.dtype = np.dtype(sensor.dtype)
        self._method, self._cheaper = method, cheaper
        self._grounded = jnp.asarray(method.grounded)
        self._policies = tuple(policies.values())
        self._corners = exploration(sensor).astype(jnp.int32)
        self._good, self._highest = jnp.asarray(good), highest
        self._drive_sign = float(np.sign(sensor.drive_voltage))
        zero, gain = calibration.offset, calibration.gain
        self._zero, self._gain = (jnp.asarray(a, self.dtype) for a in (zero, gain))
        self.traces = 0
        self.contact_count = method.count
        self._packing = Packing(jax.eval_shape(self._begun), self.dtype)
        self._said = Packing(jax.eval_shape(self._silent), self.dtype)
        # One program for all of it: each operation by itself would be one to compile.
        self.state = jax.jit(lambda: self._packing.pack(self._begun()))()
        self._each = one_function(self._packed)
        slot = self._slot(np.zeros(self.electrode_count), 0, 0, False)
        self._compiled = jax.jit(self._each).lower(self.state, *slot).compile()
        self._image = jax.jit(self._drawn)
        self._replay = jax.jit(self._replayed)

    def __reduce__(self) -> tuple[Any, ...]:
        """Lets pickle make the step anew where it goes: programs belong to a process."""
        return Step, self._made_of

    def __repr__(self) -> str:
        method = getattr(self._method, "method", self._method)
        return named(
            self,
            method=type(method).__name__,
            policies=repr(self.policies),
            electrodes=str(self.electrode_count),
            contacts_at_most=str(self.contact_count),
            dtype=str(self.dtype),
        )

    def __call__(
        self,
        state: State,
        voltages: Any,
        ground: Any,
        lost: int | np.integer = 0,
        hurried: bool = False,
    ) -> tuple[Packed, Output]:
        """Returns the state after a slot, and the slot's results."""
        slot = self._slot(voltages, ground, lost, hurried)
        after, said = self._compiled(packed(state), *slot)
        return after, self._output(said)

    def replay(
        self, state: State, voltages: Any, grounds: Any, lost: Any = None
    ) -> tuple[Packed, Output]:
        """Runs a step for each row of `voltages` (n, M); outputs have n rows."""
        v = np.asarray(voltages, self.dtype)
        fits = v.ndim == 2 and v.shape[1] == self.electrode_count
        require(fits, "voltages", f"shape {v.shape}", f"(n, {self.electrode_count})")
        g = np.asarray(grounds)
        require(g.shape == (len(v),), "grounds", f"shape {g.shape}", f"({len(v)},)")
        gone = np.zeros(len(v), np.int32) if lost is None else np.asarray(lost, np.int32)
        require(gone.shape == g.shape, "lost", f"shape {gone.shape}", f"{g.shape}")
        whole = np.stack([g.astype(np.int32), gone, np.zeros_like(gone)], 1)
        # Blocks of one size, the last filled up: one program serves any number of slots.
        parts, state = [], packed(state)
        for start in range(0, max(1, len(v)), _BLOCK):
            some = v[start : start + _BLOCK], whole[start : start + _BLOCK]
            count = len(some[0])
            some = [np.resize(a, (_BLOCK, *a.shape[1:])) for a in some]
            state, said = self._replay(state, *some, np.int32(count))
            parts.append([np.asarray(a)[:count] for a in said])
        numbers, whole = map(np.concatenate, zip(*parts))
        return state, self._output(Packed(numbers, whole))  # pyright: ignore

    def image(self, state: State) -> Float[Array, "nx ny"]:
        """Returns the last slot's image, in the method's unit; NaN for an unusable slot."""
        return self._image(packed(state))

    def save(self, path: Path | str, state: State) -> None:
        """Writes a state to an .npz file; the file is there whole or not at all."""
        save_state(path, packed(state), self.policies)

    def load(self, path: Path | str) -> Packed:
        """Reads a state that a step like this has saved.

        **Raises:** `ValueError` for a file that is none, or of another step.
        """
        return load_state(path, self.state, self.policies)

    def switch(self, state: State, policy: str) -> Packed:
        """Returns the state with another of the step's policies, from the next slot on."""
        names = ", ".join(self.policies)
        require(policy in self.policies, "policy", repr(policy), f"one of {names}")
        numbers, whole = packed(state)
        whole = np.array(whole)
        # NumPy's leaves are views of the packed arrays: no program has to be compiled.
        plan = self._packing.unpack((np.asarray(numbers), whole)).plan
        plan.policy[...], plan.length[...] = self.policies.index(policy), 0
        return Packed(jnp.asarray(numbers), jnp.asarray(whole))

    def _slot(self, voltages: Any, ground: Any, lost: Any, hurried: Any) -> tuple:
        v = np.asarray(voltages, self.dtype)
        shape = (self.electrode_count,)
        require(v.shape == shape, "voltages", f"shape {v.shape}", f"shape {shape}")
        return v, np.array((ground, lost, hurried), np.int32)

    def _output(self, said: Packed) -> Output:
        numbers, whole = np.asarray(said.numbers), np.asarray(said.whole)
        return self._said.unpack((numbers, whole))

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

    def _silent(self) -> Output:
        """Returns an output without a contact: every output has its shapes and types."""
        none = jnp.zeros((), jnp.int32)
        contacts = no_contacts(self.contact_count, self.dtype)
        return Output(contacts, jnp.zeros((), self.dtype), none, none)

    def _packed(self, state: Packed, volts: Array, whole: Array) -> tuple[Packed, Packed]:
        """Runs one slot."""
        self.traces += 1
        slot = Slot(volts, whole[0], whole[1], whole[2] > 0)
        remembered, said = self._run(self._packing.unpack(state), slot)
        return self._packing.pack(remembered), self._said.pack(said)

    def _replayed(self, state: Packed, volts: Array, whole: Array, count: Array) -> tuple:
        """Runs the first `count` slots; the outputs of the other slots are 0."""
        silent = self._said.pack(self._silent())
        said = jax.tree.map(lambda a: jnp.zeros((len(volts), *a.shape), a.dtype), silent)

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

    def _drawn(self, state: Packed) -> Float[Array, "nx ny"]:
        remembered = self._packing.unpack(state)
        image = self._method.image(remembered.memory, remembered.last)
        return jnp.where(remembered.used.any(), image, jnp.nan)
