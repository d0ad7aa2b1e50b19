"""Evaluates P2 nodal values at points."""

import numpy as np
from scipy.spatial import cKDTree


def p2(part):
    """P2 shapes (…, 6) of barycentric places (…, 3): vertices, then edges 01, 12, 20."""
    a, b, c = part[..., 0], part[..., 1], part[..., 2]
    return np.stack(
        [
            a * (2 * a - 1),
            b * (2 * b - 1),
            c * (2 * c - 1),
            4 * a * b,
            4 * b * c,
            4 * c * a,
        ],
        -1,
    )


def locate(nodes, tri, pts, k=40):
    """(n,) triangle and (n,3) barycentric coordinates of each point."""
    v = nodes[tri[:, :3]]
    tree = cKDTree(v.mean(1))
    which = np.zeros(len(pts), int)
    bary = np.zeros((len(pts), 3))
    for s in range(0, len(pts), 20000):
        p = pts[s : s + 20000]
        _, near = tree.query(p, k)
        w = v[near]
        d1, d2, q = (
            w[..., 1, :] - w[..., 0, :],
            w[..., 2, :] - w[..., 0, :],
            p[:, None] - w[..., 0, :],
        )
        det = d1[..., 0] * d2[..., 1] - d1[..., 1] * d2[..., 0]
        b = (q[..., 0] * d2[..., 1] - q[..., 1] * d2[..., 0]) / det
        c = (d1[..., 0] * q[..., 1] - d1[..., 1] * q[..., 0]) / det
        part = np.stack([1 - b - c, b, c], -1)
        best = part.min(-1).argmax(1)
        r = np.arange(len(p))
        which[s : s + 20000] = near[r, best]
        bary[s : s + 20000] = part[r, best]
    return which, bary


def evaluate(nodes, tri, values, pts):
    """values (N, M) at P2 nodes -> (M, n)."""
    which, bary = locate(nodes, tri, pts)
    return np.einsum("nk,nkm->mn", p2(np.clip(bary, -0.05, 1.05)), values[tri[which]])
