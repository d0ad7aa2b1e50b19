"""Computes resistances and loaded fields of any sheet by P1 finite elements.

The work is one factorisation, three right-hand sides per electrode (its feed and two
dipoles) and the band of the inverse.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import factor, inverse_band, matmul, solve
from tomojax.kernels.sheet import _stiffness
from tomojax.kernels.sheet._electrodes import (
    dipole_weights,
    feed_weights,
    Feeds,
    metal_shares,
    series_resistances,
)
from tomojax.kernels.sheet._mesh import namespace, Shape, triangles, Values
from tomojax.kernels.sheet._reduction import ContactReduction, touch_electrodes
from tomojax.kernels.sheet._skin import coverage, OUTSIDE, pinned_node, Skin, stiffness_on
from tomojax.kernels.sheet._slots import centred, Resistances
from tomojax.kernels.sheet._stiffness import reference_stiffness


class FemSheet(NamedTuple):
    """A sheet on its mesh: all that the factorisation needs."""

    local: Float[Values, "K 3 3"]  # stiffness of each element, S
    pinned: Int[Values, ""]  # the node at 0 V
    feeds: Float[Values, "nodes M"]  # shares of each electrode's current per node
    series: Float[Values, " M"]  # Ω, see `series_resistances`
    dipoles: Float[Values, "nodes D"]  # 1/m, D = 2M, or 0 for electrodes without extent
    dipole_series: Float[Values, " D"]  # Ω/m²
    metal: Float[Values, "nodes M"]  # share of a node's contact that is on an electrode


def fem_sheet(
    sheet: Float[Values, " K"],
    places: Float[Values, "M 2"],
    radius: Float[Values, ""],
    shape: Shape,
    size: Float[Values, "2"],
    shunt: Float[Values, ""] | None = None,
    skin: Skin | None = None,
) -> FemSheet:
    """Puts electrodes on the mesh of a sheet of conductance `sheet` (S per square).

    `shunt`: dipole of a floating electrode, as a part of an equipotential disc's. None
    leaves out the dipoles, and so two thirds of the right-hand sides. `skin`: outline and
    surface of a sheet that is no flat rectangle.
    """
    at = Feeds.of(places, radius, shape, size, skin)
    if skin is None:
        local = reference_stiffness(shape, size)
    else:
        sheet = sheet * namespace(sheet).maximum(coverage(skin, shape), OUTSIDE)
        local = stiffness_on(skin, shape, size)
    series, dipole_series = series_resistances(at, sheet, shunt)
    feeds = feed_weights(at)
    return FemSheet(
        local=sheet[:, None, None] * local,
        pinned=namespace(sheet).asarray(pinned_node(skin, shape)),
        feeds=feeds,
        series=series,
        dipoles=feeds[:, :0] if shunt is None else dipole_weights(at, feeds),
        dipole_series=dipole_series,
        metal=metal_shares(at),
    )


def _pinned_solver(fem: FemSheet, contact: Float[Array, " nodes"], shape: Shape):
    """Returns the factor, and rhs ↦ A⁻¹·rhs with the pinned node at 0 V and its own rule.

    The rule follows from A x = b: dx = A⁻¹(db − dA x). The derivative runs through the
    operator and one more solve with the same factor, never through the factorisation.
    """
    matrix = _stiffness.assemble(fem.local, contact, shape, fem.pinned)
    from_pin = _from_pin(fem, contact, shape)
    pin = _stiffness.mean_conductance(fem.local)
    row_sums = (contact + from_pin).at[fem.pinned].set(pin)
    chol = factor(matrix, row_sums)

    def operator(x: Array) -> Array:
        still = x.at[fem.pinned].set(0)
        currents = _stiffness.apply(fem.local, contact, shape, still)
        return currents.at[fem.pinned].set(pin * x[fem.pinned])

    def pinned_solve(rhs: Float[Array, "nodes m"]) -> Float[Array, "nodes m"]:
        return jax.lax.custom_linear_solve(
            operator,
            rhs.at[fem.pinned].set(0),
            solve=lambda _, b: solve(jax.lax.stop_gradient(chol), b),
            symmetric=True,
        )

    return chol, pinned_solve


def _from_pin(
    fem: FemSheet, contact: Float[Array, " nodes"], shape: Shape
) -> Float[Array, " nodes"]:
    """Computes currents (A) into the other nodes with the pinned node at 1 V."""
    at_pin = jnp.zeros_like(fem.feeds[:, :1]).at[fem.pinned].set(1)
    return -_stiffness.apply(fem.local, contact, shape, at_pin)[:, 0]


class _Ports(NamedTuple):
    """Fields of electrodes and dipoles, and the dipoles' answer to any field."""

    q: Float[Array, "M M"]  # feeds among each other, dipoles answered
    feed_dipole: Float[Array, "M D"]
    dipole: Float[Array, "D D"]  # Cholesky factor of the dipoles' own resistances

    def answer(self, at_dipoles: Float[Array, "D n"]) -> Float[Array, "D n"]:
        """Computes L⁻¹·(field at the dipoles); shunts take products of two such answers."""
        if not len(self.dipole):
            return at_dipoles
        return triangular_solve(self.dipole, at_dipoles, left_side=True, lower=True)


def _ports(fem: FemSheet, fields: Float[Array, "nodes ports"]) -> _Ports:
    """Computes Q = P'ᵀA⁻¹P' without dipoles: Q_pp − Q_pd (Q_dd + δ_d)⁻¹ Q_dp."""
    m = fem.feeds.shape[1]
    q = matmul(fem.feeds.T, fields[:, :m])
    feed_dipole = matmul(fem.feeds.T, fields[:, m:])
    dd = matmul(fem.dipoles.T, fields[:, m:])
    dd = (dd + dd.T) / 2 + jnp.diag(fem.dipole_series)
    chol = jnp.linalg.cholesky(dd) if len(dd) else dd
    raw = _Ports(q, feed_dipole, chol)
    shunted = raw.answer(feed_dipole.T)
    q = (q + q.T) / 2 + jnp.diag(fem.series) - matmul(shunted.T, shunted)
    return raw._replace(q=q)


def fem_resistances(fem: FemSheet, shape: Shape) -> Resistances:
    """Computes R_ee, R_ek and R_kk (Ω) of a sheet on its mesh, centred.

    **Arguments:** `fem`: the sheet and its electrodes; `shape` (nx, ny): cells.
    **Returns:** `Resistances` with M electrodes and K = 2·nx·ny elements.
    """
    chol, pinned_solve = _pinned_solver(fem, jnp.zeros_like(fem.feeds[:, 0]), shape)
    fields = pinned_solve(jnp.concatenate([fem.feeds, fem.dipoles], 1))
    ports = _ports(fem, fields)
    at_elements = fields[triangles(shape)].mean(1).T  # over each one's vertices
    ek, element_shunt = _answered(fem, ports, at_elements)
    kk = _own_resistance(chol, fem.pinned, shape) - (element_shunt**2).sum(0)
    return centred(Resistances(ports.q, ek, kk))


def fem_fields(
    fem: FemSheet, shape: Shape
) -> tuple[Float[Array, "M M"], Float[Array, "M nodes"]]:
    """Computes R_ee' and R_e at the nodes, Ω, centred."""
    _, pinned_solve = _pinned_solver(fem, jnp.zeros_like(fem.feeds[:, 0]), shape)
    fields = pinned_solve(jnp.concatenate([fem.feeds, fem.dipoles], 1))
    ports = _ports(fem, fields)
    at_nodes, _ = _answered(fem, ports, fields.T)
    none = jnp.zeros_like(at_nodes[0])
    ee, en, _ = centred(Resistances(ports.q, at_nodes, none))
    return ee, en


def _answered(
    fem: FemSheet, ports: _Ports, fields: Float[Array, "ports n"]
) -> tuple[Float[Array, "M n"], Float[Array, "D n"]]:
    """Computes fields of electrodes with the dipoles' answer, and that answer."""
    m = fem.feeds.shape[1]
    shunt, there = (ports.answer(f) for f in (ports.feed_dipole.T, fields[m:]))
    return fields[:m] - matmul(shunt.T, there), there


def _own_resistance(chol, pinned: Array, shape: Shape) -> Float[Array, " K"]:
    """Computes R_kk = b_kᵀ R b_k from the inverse's band; the pinned node counts zero."""
    band = inverse_band(chol)
    b = band.diagonal.shape[-1]
    at = pinned // b, pinned % b, pinned % b
    diagonal = band.diagonal.at[at].set(0)
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


def fem_shared_resistances(
    fem: FemSheet, shares: Float[Array, "sites c"], shape: Shape
) -> tuple[Float[Array, "M c"], Float[Array, "c c"]]:
    """Computes R_ec and R_cc' (Ω) of c groups of sites, centred like the table.

    A site is a node, or electrode e as N + e: all that `fem_contact` can touch. A column of
    `shares` splits a group's current among sites; columns sum to 1. From these resistances
    `reduce_sites` gives the result of `fem_contact` without another factorisation.
    """
    _, pinned_solve = _pinned_solver(fem, jnp.zeros_like(fem.feeds[:, 0]), shape)
    n = len(fem.feeds)
    on_metal = shares[n:]
    load = shares[:n] + matmul(fem.feeds, on_metal)
    own = fem.feeds.shape[1] + fem.dipoles.shape[1]
    fields = pinned_solve(jnp.concatenate([fem.feeds, fem.dipoles, load], 1))
    fields, loaded = fields[:, :own], fields[:, own:]
    ports = _ports(fem, fields)
    shunt = ports.answer(ports.feed_dipole.T)
    load_shunt = ports.answer(matmul(fem.dipoles.T, loaded))
    in_series = fem.series[:, None] * on_metal
    ec = matmul(fem.feeds.T, loaded) - matmul(shunt.T, load_shunt) + in_series
    cc = matmul(load.T, loaded) - matmul(load_shunt.T, load_shunt)
    cc = (cc + cc.T) / 2 + matmul(on_metal.T, in_series)
    row, column, mean = ports.q.mean(0), ec.mean(0), ports.q.mean()
    return (
        ec - row[:, None] - column[None, :] + mean,
        cc - column[:, None] - column[None, :] + mean,
    )


def site_conductance(
    fem: FemSheet, contact: Float[Array, " K"], shape: Shape
) -> Float[Array, " sites"]:
    """Turns conductances (S) on elements into conductances on nodes and electrodes.

    A third of an element's conductance goes to each of its vertices. The share `metal` of a
    node's conductance goes to the electrodes.
    """
    at_nodes = _stiffness.spread(contact, shape)
    direct = matmul(at_nodes, fem.metal)
    return jnp.concatenate([at_nodes * (1 - fem.metal.sum(1)), direct])


def fem_contact(
    fem: FemSheet, contact: Float[Array, " sites"], shape: Shape
) -> ContactReduction:
    """Reduces a sheet in contact to its electrodes, from one factorisation.

    **Arguments:** `contact` g: S per site, see `site_conductance`.
    **Returns:** `ContactReduction`; voltages under any grounds follow from it.

    The sheet is pinned at one node (not at an electrode, so that every ground is treated
    alike). The right-hand sides are: electrodes and their dipoles; the object at 1 V; the
    pinned node at 1 V. The last two fields add up to one everywhere. Each field is used
    where it is the smaller one, so that neither weak nor strong contacts lose digits.
    """
    n, m = fem.feeds.shape
    at_nodes, direct = contact[:n], contact[n:]
    _, pinned_solve = _pinned_solver(fem, at_nodes, shape)
    ends = jnp.stack([at_nodes, _from_pin(fem, at_nodes, shape)], 1)
    fields = pinned_solve(jnp.concatenate([fem.feeds, fem.dipoles, ends], 1))
    own = m + fem.dipoles.shape[1]
    ports = _ports(fem, fields[:, :own])
    lift, shortfall = fields[:, own], fields[:, own + 1].at[fem.pinned].set(1)
    # Dipoles carry no net current, so that the lift's field is minus the shortfall's.
    answered = ports.answer(matmul(fem.dipoles.T, shortfall[:, None]))
    shunt = ports.answer(ports.feed_dipole.T)
    node_shunt = ports.answer(fields[:, m:own].T).T
    moved = matmul(shunt.T, answered)[:, 0]
    through = jnp.vdot(at_nodes, shortfall, precision="highest")
    on_sheet = ContactReduction(
        conductance=through + (answered**2).sum(),
        lift=matmul(fem.feeds.T, lift) + moved,
        shortfall=matmul(fem.feeds.T, shortfall) - moved,
        resistance=ports.q,
        field=fields[:, :m] - matmul(node_shunt, shunt),
        gap=shortfall - matmul(node_shunt, answered)[:, 0],
    )
    return touch_electrodes(on_sheet, direct)
