"""The input, the memory and the output of a step."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tomojax._shown import tuple_shown
from tomojax.kernels.images import Contacts, no_contacts
from tomojax.step._policies import Plan


class Slot(NamedTuple):
    """The readings of one ground condition."""

    voltages: Any  # (M,) V; NaN where a channel gave nothing
    ground: Any  # the electrode that was grounded, whichever was asked for
    lost: Any  # slots lost since the one before
    hurried: Any  # bool: whether the cheaper method is to answer


class Output(NamedTuple):
    """The results of a step.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])
    >>> step = tx.make_step(sensor, "source", ["boundary", "all"], contacts=1, grid=8)
    >>> out = step(step.state, volts[0], 0)[1]
    >>> out.contacts.xy.shape, bool(out.residual < 0.1)
    ((1, 2), True)
    """

    contacts: Contacts
    residual: Float[Array, ""]  # V rms
    flags: Int[Array, ""]  # bits of `Flag`
    ground: Int[Array, ""]  # to be grounded next

    def __repr__(self) -> str:
        return tuple_shown(self, residual=("V", 1.0))


def silent(contacts: int, dtype: Any) -> Output:
    """Returns an output without a contact: every output has its shapes and types."""
    none = jnp.zeros((), jnp.int32)
    return Output(no_contacts(contacts, dtype), jnp.zeros((), dtype), none, none)


class Read(NamedTuple):
    """A slot, corrected and checked."""

    voltages: Float[Array, " M"]  # corrected, V; 0 where not used
    used: Bool[Array, " M"]
    ground: Int[Array, ""]  # an electrode, whatever came
    elapsed: Float[Array, ""]  # slots since the one before
    ok: Bool[Array, ""]  # whether it says anything
    flags: Int[Array, ""]


class Doubt(NamedTuple):
    """A doubt that contacts explain all voltages, kept from slot to slot."""

    stretch: Bool[Array, ""]  # in a slot of this stretch of grounds
    held: Int[Array, ""]  # slots that an earlier doubt still counts in
    full: Bool[Array, ""]  # whether every contact that may be was there in the last slot


class Remembered(NamedTuple):
    """The whole memory of a step; callers hold the memory packed into two arrays."""

    memory: Any
    cheaper: Any
    plan: Plan
    doubt: Doubt
    last: Slot
    used: Bool[Array, " M"]


class About(NamedTuple):
    """The facts of a step that its face needs; arithmetic is in `Traced`, or in C."""

    electrode_count: int
    condition_count: int
    contact_count: int
    policies: tuple[str, ...]
    dtype: str
    method: str
    # Where the plan is among the state's whole numbers.
    policy_at: int
    length_at: int
    ground_at: int  # the first ground
    image: tuple[int, int]  # pixels
    drive: float  # V
