"""A point contact against pyEIT: the contact's node is one more electrode there."""

import jax.numpy as jnp
import numpy as np
import pytest
import references
from pyeit.eit.fem import EITForward
from pyeit.eit.protocol import PyEITProtocol
from pyeit.mesh import PyEITMesh

from tomojax.kernels.sheet import (
    fem_resistances,
    FemSheet,
    nodes as mesh_nodes,
    reference_stiffness,
    Resistances,
    triangles,
)


@pytest.mark.long
def test_slot_voltages_of_a_point_contact(rng) -> None:
    shape, size = (24, 20), jnp.array([0.12, 0.10])
    nodes = np.asarray(mesh_nodes(shape, size))
    vertices = references.counterclockwise(nodes, triangles(shape))
    sheet = 1e-4 * np.exp(0.5 * rng.standard_normal(len(vertices)))
    chosen = rng.choice(np.arange(1, len(nodes) - 1), 17, replace=False)
    contact = 16  # the last of the chosen nodes; the others are electrodes

    m = 16
    mesh = PyEITMesh(node=nodes, element=vertices, perm=sheet, el_pos=chosen, ref_node=0)
    pairs = np.array([[contact, ground] for ground in range(m)])
    to_ground = np.array([[[e, ground] for e in range(m)] for ground in range(m)])
    protocol = PyEITProtocol(pairs, to_ground, np.ones(m * m, bool))
    want = EITForward(mesh, protocol).solve_eit().reshape(m, m)

    feeds = jnp.zeros((len(nodes), 17)).at[chosen, np.arange(17)].set(1.0)
    none = jnp.zeros((len(nodes), 0))
    local = jnp.asarray(sheet)[:, None, None] * reference_stiffness(shape, size)
    last = jnp.array(len(nodes) - 1)
    point = FemSheet(local, last, feeds, jnp.zeros(17), none, none[0], 0 * feeds)
    ee, _, _ = fem_resistances(point, shape)
    table = Resistances(ee[:m, :m], ee[:m, m:], ee[m:, m])
    t = references.slot_map(table, jnp.arange(m), jnp.array(0.0))
    got = np.asarray(t[:, :, 0])  # volts for one ampere
    off_ground = ~np.eye(m, dtype=bool)
    np.testing.assert_allclose(got[off_ground], want[off_ground], rtol=1e-10)
    np.testing.assert_allclose(got[~off_ground], 0, atol=1e-9)
