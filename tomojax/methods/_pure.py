"""Methods as pure functions of arrays: of a frame's voltages, and of the sensor."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import no_contacts
from tomojax.methods._batch import check_limits
from tomojax.methods._contract import (
    AbstractMethod,
    Estimate,
    grounded_of,
    judged,
    masked,
    rms,
    rms_by_electrode,
)
from tomojax.methods._doubts import look_at
from tomojax.methods._names import method
from tomojax.methods._rows import Rows
from tomojax.methods.points._points import Points
from tomojax.sensor import Sensor


class Ready(eqx.Module):
    """A method at known grounds, as a pure function of one frame's voltages.

    All of it is JAX: `jax.vmap`, `jax.jit`, `jax.grad` and shardings apply as to any
    function, and arrays stay on their device. A row is as of `Batch`: frames without a
    contact, flags and doubts are inside. A used voltage that is no number fails its frame.
    "auto" takes many frames by `jax.lax.map`: under `jax.vmap` all would pay for its
    largest model.

    **Arguments:** `method` of `tomojax.method`; `grounds` (S,) of a scan, or (P, S) of P
    kinds of scan; `good` (S, M) or (P, S, M), the voltages to use (all by default). The
    rest is as of `Batch`.

    **Example:**

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
    >>> ready = tx.methods.Ready(tx.method(sensor, grid=16), [0, 15], contacts=2)
    >>> rows = jax.jit(jax.vmap(ready))(jnp.stack([volts, 0 * volts]))
    >>> print(rows.contact_count, jnp.round(1e3 * rows.contact_xy[0, 0]))  # mm
    [1 0] [30. 50.]
    >>> place = lambda v: ready(v).contact_xy[0, 0]  # x, m
    >>> jax.grad(place)(volts).shape
    (2, 16)
    """

    method: AbstractMethod
    prepared: Any  # of each kind of scan, along the first axis of each array
    grounds: Int[Array, "P S"]
    good: Bool[Array, "P S M"]
    grounded: Bool[Array, "L M"]
    threshold: Float[Array, ""]
    contacts: int = eqx.field(static=True)
    images: bool = eqx.field(static=True)

    def __init__(
        self,
        method: AbstractMethod,
        grounds: Any,
        good: Any = None,
        lam: float | None = None,
        contacts: int = 4,
        images: bool = True,
        threshold: float | None = None,
    ):
        each, m = np.atleast_2d(np.asarray(grounds, int)), method.electrode_count
        grounded = np.asarray(grounded_of(method))
        inside = (
            each.ndim == 2 and each.size and 0 <= each.min() and each.max() < len(grounded)
        )
        require(
            inside, "grounds", np.shape(grounds), f"(P, S) from 0 to {len(grounded) - 1}"
        )
        shape = *each.shape, m
        used = np.ones(shape, bool) if good is None else np.asarray(good, bool)
        require(used.shape in (shape, shape[1:]), "good", f"shape {used.shape}", f"{shape}")
        used = np.broadcast_to(used, shape)
        require(used.any((1, 2)).all(), "good", "none in a scan", "a voltage in each")
        lam = method.choose_lambda([]) if lam is None else lam
        threshold = float(method.threshold) if threshold is None else threshold
        check_limits(lam, contacts, threshold)
        alike = np.where(used.any(2), each, 0)
        ready = [method.prepare(g, u, float(lam)) for g, u in zip(alike, used)]
        self.method, self.grounds = method, jnp.asarray(alike)
        self.prepared = jax.tree.map(lambda *a: jnp.asarray(np.stack(a)), *ready)
        self.good, self.grounded = jnp.asarray(used), jnp.asarray(grounded)
        self.threshold = jnp.asarray(threshold, method.cell.dtype)
        self.contacts, self.images = int(contacts), images

    def __call__(
        self, voltages: Float[Array, "S M"], which: int | Int[Array, ""] = 0
    ) -> Rows:
        """Returns the row of a frame; `which` kind of scan."""
        shape = np.shape(voltages)
        fits = shape == self.good.shape[1:]
        require(fits, "voltages", f"shape {shape}", f"{self.good.shape[1:]}")
        return self._row(voltages, jnp.asarray(which))

    @eqx.filter_jit
    def _row(self, voltages: Float[Array, "S M"], which: Int[Array, ""]) -> Rows:
        one = lambda a: jnp.asarray(a)[which]  # noqa: E731
        good, method = one(self.good), self.method
        v = jnp.where(good, voltages, 0)
        told = method.drive_sign, method.noise, method.highest
        about = one(self.grounds)[None], good[None], *told
        looked = look_at(v[None], *about, self.grounded, jnp)
        prepared = jax.tree.map(one, self.prepared)
        row = judged(method, method.estimate(prepared, v, self.contacts), v, self.images)
        quiet = looked.height[0] <= self.threshold
        many = row.contact_count > looked.most[0].astype(row.contact_count.dtype)
        doubts = looked.flags[0] | jnp.where(many, np.uint32(Flag.PLACE_UNCERTAIN), 0)
        row = row._replace(flags=row.flags.astype(np.uint32) | doubts)
        return tree_where(quiet, self._nothing(row, v, good), row)

    def _nothing(self, row: Rows, v: Array, good: Array) -> Rows:
        """Returns the row of a frame whose voltages are noise, all of them left over."""
        none = no_contacts(self.contacts, v.dtype)
        drawn = {
            name: masked(self.method, jnp.zeros_like(image))
            for name in ("image", "touch", "image_deviation")
            if (image := getattr(row, name)) is not None
        }
        if row.residual_by_electrode is not None:
            drawn["residual_by_electrode"] = rms_by_electrode(v, good)
        return Rows.of(
            none,
            residual=rms(v, good),
            flags=jnp.full_like(row.flags, Flag.NO_CONTACT.value),
            rung=jnp.zeros_like(row.rung),
            **drawn,
        )


def estimate(
    sensor: Sensor,
    voltages: Float[Array, "S M"],
    grounds: Numbers,
    name: str = "points",
    *,
    contacts: int = 1,
    grid: int | None = None,
    lam: float | Float[Array, ""] | None = None,
) -> Estimate:
    """Estimates the contacts of one frame; differentiable in sensor, voltages and λ.

    The fit follows its optimum's own rule. A method's tables are made on the host: their
    slopes by the sensor and by λ are differences of two tables, along the tangent
    (`jax.jvp`), or along each number that is differentiated (`jax.grad`, two tables each).
    Sensor and λ must be known: `jax.jit` around them raises JAX's error for that.

    **Arguments:** `voltages` (S, M), V; `grounds` (S,); `name` and `grid` as in `method`;
    `lam`, the method's own λ by default.
    **Raises:** `ValueError` as `method` and `Ready`, and where a method's tables change
    their sizes within the step of a difference.

    **Example:**

    >>> import jax
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch, grounds = tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]
    >>> volts = tx.voltages(sensor, touch, grounds)
    >>> found = tx.methods.estimate(sensor, volts, grounds, grid=16)
    >>> print((1e3 * found.contacts.xy[0]).round())
    [30. 50.]
    """
    given = sensor, lam if lam is None else jnp.asarray(lam, sensor.dtype)
    model, prepared = _ready(given, np.asarray(grounds), voltages.shape, name, grid)
    return _estimated(model, prepared, voltages, contacts)


_estimated = eqx.filter_jit(lambda model, *given: model.estimate(*given))


@eqx.filter_custom_jvp
def _ready(given: Any, grounds: Any, shape: tuple, name: str, grid: int | None) -> Any:
    """Makes the method and its preparation for slots, of (sensor, λ), all arrays of JAX."""
    sensor, lam = given
    model = method(sensor, name, grid)
    lam = model.choose_lambda([]) if lam is None else float(lam)
    check_limits(lam, 1, 0.0)
    if isinstance(model, Points):
        model = replace(model, exact=True)
    good = np.ones(shape, bool)
    prepared = model.prepare(np.asarray(grounds), good, lam)
    return jax.tree.map(jnp.asarray, (model, prepared))


@_ready.def_jvp
def _(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    known, *given = primals
    made = _ready(known, *given)
    leaves, tree = jax.tree.flatten(tangents[0])
    values = jax.tree.leaves(_beside(known, tangents[0]))
    if not any(isinstance(leaf, Tracer) for leaf in leaves):
        return made, _difference(made, known, tangents[0], given)
    total: Any = None
    for which, value in enumerate(values):
        for number in range(value.size):
            unit = np.zeros(value.size)
            unit[number] = 1
            along = [jnp.zeros_like(v) for v in values]
            along[which] = jnp.asarray(unit.reshape(value.shape), value.dtype)
            part = leaves[which].reshape(-1)[number]
            slope = _difference(made, known, jax.tree.unflatten(tree, along), given)
            slope = jax.tree.map(lambda s, part=part: s * part.astype(s.dtype), slope)
            total = slope if total is None else jax.tree.map(jnp.add, total, slope)
    return made, total


def _beside(known: Any, tangent: Any) -> Any:
    """Returns the sensor's arrays, and λ, that have a tangent."""
    found = lambda t, a: None if t is None else a  # noqa: E731
    return jax.tree.map(found, tangent, known, is_leaf=lambda t: t is None)


def _difference(made: Any, known: Any, tangent: Any, given: list) -> Any:
    """Computes the tables' slopes along a tangent, by central differences."""
    values, ways = (jax.tree.leaves(t) for t in (_beside(known, tangent), tangent))
    parts = [float(abs(w).max() / max(abs(v).max(), 1e-30)) for v, w in zip(values, ways)]
    # The cube root balances a difference's rounding and its own error.
    step = float(jnp.finfo(values[0].dtype).eps) ** (1 / 3) / (max(parts) or 1.0)

    def at(side: float) -> Any:
        add = lambda t, a: a if t is None else a + side * step * t  # noqa: E731
        moved = jax.tree.map(add, tangent, known, is_leaf=lambda t: t is None)
        return _ready(moved, *given)

    one, other = at(1.0), at(-1.0)
    shapes = [jax.tree.map(jnp.shape, tree) for tree in (one, made, other)]
    alike = shapes[0] == shapes[1] == shapes[2]
    require(alike, "sensor", "tables of other sizes a step aside", "a sensor beside it")

    def slope(a: Array, b: Array) -> Array | None:
        return (a - b) / (2 * step) if eqx.is_inexact_array(a) else None

    return jax.tree.map(slope, one, other)
