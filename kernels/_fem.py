"""Resistances and loaded fields of any sheet by P1 finite elements.

One factorisation, one right-hand side per electrode and the band of the inverse.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels import _stiffness
from tomojax.kernels._blocktri import factor, inverse_band, matmul, solve
from tomojax.kernels._electrodes import feed_weights, feed_width, series_resistance
from tomojax.kernels._mesh import Shape, triangles
from tomojax.kernels._reduction import ContactReduction
from tomojax.kernels._table import centred, Resistances


class FemSheet(NamedTuple):
    """A sheet on its mesh: what the factorisation is made of."""

    sheet: Float[Array, " K"]  # conductance, S per square
    size: Float[Array, "2"]  # m
    feeds: Float[Array, "nodes M"]  # shares of each electrode's current per node
    series: Float[Array, " M"]  # Ω, see `series_resistance`


def fem_sheet(
    sheet: Float[Array, " K"],
    places: Float[Array, "M 2"],
    radius: Float[Array, ""],
    shape: Shape,
    size: Float[Array, "2"],
) -> FemSheet:
    """Electrodes put on the mesh of a sheet of conductance `sheet` (S per square)."""
    width = feed_width(radius, shape, size)
    return FemSheet(
        sheet,
        size,
        feed_weights(places, width, shape, size),
        series_resistance(sheet, places, radius, shape, size),
    )


def _pinned_solver(fem: FemSheet, contact: Float[Array, " K"], shape: Shape):
    """(factor, rhs ↦ A⁻¹·rhs with the last node at 0 V), and the solve's own rule.

    From A x = b: dx = A⁻¹(db − dA x). The derivative runs through the operator and
    one more solve with the same factor, never through the factorisation.
    """
    matrix = _stiffness.assemble(fem.sheet, contact, shape, fem.size)
    from_pin = _from_pin(fem, contact, shape)
    pin = matrix.diagonal[-1, -1, -1]
    row_sums = (_stiffness.spread(contact, shape) + from_pin).at[-1].set(pin)
    chol = factor(matrix, row_sums)

    def operator(x: Array) -> Array:
        currents = _stiffness.apply(
            fem.sheet, contact, shape, fem.size, x.at[-1].set(0)
        )
        return currents.at[-1].set(pin * x[-1])

    def pinned_solve(rhs: Float[Array, "nodes m"]) -> Float[Array, "nodes m"]:
        return jax.lax.custom_linear_solve(
            operator,
            rhs.at[-1].set(0),
            solve=lambda _, b: solve(jax.lax.stop_gradient(chol), b),
            symmetric=True,
        )

    return chol, pinned_solve


def _from_pin(
    fem: FemSheet, contact: Float[Array, " K"], shape: Shape
) -> Float[Array, " nodes"]:
    """Currents (A) into the other nodes with the pinned one at 1 V."""
    at_pin = jnp.zeros_like(fem.feeds[:, :1]).at[-1].set(1)
    return -_stiffness.apply(fem.sheet, contact, shape, fem.size, at_pin)[:, 0]


def fem_resistances(fem: FemSheet, shape: Shape) -> Resistances:
    """R_ee, R_ek and R_kk (Ω) of a sheet on its mesh, centred.

    **Arguments:** `fem`: the sheet and its electrodes; `shape` (nx, ny): cells.
    **Returns:** `Resistances` with M electrodes and K = 2·nx·ny elements.
    """
    chol, pinned_solve = _pinned_solver(fem, jnp.zeros_like(fem.sheet), shape)
    fields = pinned_solve(fem.feeds)
    ee = matmul(fem.feeds.T, fields)
    ee = (ee + ee.T) / 2 + jnp.diag(fem.series)
    ek = _stiffness.at_elements(fields, shape).T
    return centred(Resistances(ee, ek, _own_resistance(chol, shape)))


def _own_resistance(chol, shape: Shape) -> Float[Array, " K"]:
    """R_kk = b_kᵀ R b_k from the band of the inverse; the pinned node counts zero."""
    band = inverse_band(chol)
    diagonal = band.diagonal.at[-1, -1, -1].set(0)
    b = diagonal.shape[-1]
    vertices = triangles(shape)
    own = jnp.zeros(len(vertices), diagonal.dtype)
    for one, other in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        pair = vertices[:, [one, other]]
        high, low = pair.max(1), pair.min(1)
        same = high // b == low // b
        within = diagonal[high // b, high % b, low % b]
        between = band.lower[low // b - (low // b == len(diagonal) - 1), high % b, low % b]
        value = jnp.where(same, within, between)
        own = own + value * (1 if one == other else 2)
    return own / 9


def fem_element_columns(
    fem: FemSheet, elements: Int[Array, " c"], shape: Shape
) -> tuple[Float[Array, "M c"], Float[Array, "K c"]]:
    """R_ec and R_kc (Ω) for chosen elements c against all K, centred like the table."""
    _, pinned_solve = _pinned_solver(fem, jnp.zeros_like(fem.sheet), shape)
    one_hot = jnp.zeros((fem.sheet.size, elements.size), fem.sheet.dtype)
    one_hot = one_hot.at[elements, jnp.arange(elements.size)].set(1)
    loads = jax.vmap(lambda v: _stiffness.spread(v, shape), 1, 1)(one_hot)
    count = fem.feeds.shape[1]
    fields = pinned_solve(jnp.concatenate([fem.feeds, loads], 1))
    ee = matmul(fem.feeds.T, fields[:, :count]) + jnp.diag(fem.series)
    ec = matmul(fem.feeds.T, fields[:, count:])
    ke = _stiffness.at_elements(fields[:, :count], shape)
    kc = _stiffness.at_elements(fields[:, count:], shape)
    row, mean = ee.mean(0), ee.mean()
    over_c, over_k = ec.mean(0), ke.mean(1)
    return (
        ec - row[:, None] - over_c[None, :] + mean,
        kc - over_k[:, None] - over_c[None, :] + mean,
    )


def fem_contact(
    fem: FemSheet, contact: Float[Array, " K"], shape: Shape
) -> ContactReduction:
    """Reduction of a sheet in contact to its electrodes, from one factorisation.

    **Arguments:** `contact` g: S per element, zero where nothing touches.
    **Returns:** `ContactReduction`; voltages under any grounds follow from it.

    The sheet is pinned at one node (not at an electrode, so that every ground is
    treated alike). Right-hand sides: the electrodes; the object at 1 V; the pinned
    node at 1 V. The last two add up to one everywhere and each is used where it is the
    small one, so that neither weak nor strong contacts lose digits.
    """
    _, pinned_solve = _pinned_solver(fem, contact, shape)
    load = _stiffness.spread(contact, shape)
    ends = jnp.stack([load, _from_pin(fem, contact, shape)], 1)
    fields = pinned_solve(jnp.concatenate([fem.feeds, ends], 1))
    count = fem.feeds.shape[1]
    shortfall = fields[:, count + 1].at[-1].set(1)
    at_elements = _stiffness.at_elements(fields, shape)
    gap = _stiffness.at_elements(shortfall[:, None], shape)[:, 0]
    q = matmul(fem.feeds.T, fields[:, :count])
    return ContactReduction(
        conductance=jnp.vdot(contact, gap, precision="highest"),
        lift=matmul(fem.feeds.T, fields[:, count]),
        shortfall=matmul(fem.feeds.T, shortfall),
        resistance=(q + q.T) / 2 + jnp.diag(fem.series),
        field=at_elements[:, :count],
        gap=gap,
    )
