"""The sheets that Peer and tomojax are compared on (numpy only)."""

import numpy as np

KINDS = ("one", "two", "three", "bar", "letter")
RASTER = 160  # pixels of the longer side, that shapes' overlap is told on


def circle(c, r, n):
    # Sides of equal area with the circle's.
    t = 2 * np.pi * (np.arange(n) + 0.5) / n
    r = r * np.sqrt(2 * np.pi / n / np.sin(2 * np.pi / n))
    return np.asarray(c) + r * np.stack([np.cos(t), np.sin(t)], -1)


def grid(nx, ny, pitch, x0, y0):
    return np.stack(
        np.meshgrid(x0 + pitch * np.arange(nx), y0 + pitch * np.arange(ny), indexing="ij"),
        -1,
    ).reshape(-1, 2)


def ring(c, r, n, t0=0.0):
    t = t0 + 2 * np.pi * np.arange(n) / n
    return np.asarray(c) + r * np.stack([np.cos(t), np.sin(t)], -1)


RC = 0.04  # radius of the half cylinder
CW = np.pi * RC


def cylinder(p, xp=np):
    return xp.stack(
        [RC * xp.cos(p[..., 0] / RC), RC * xp.sin(p[..., 0] / RC), p[..., 1]], -1
    )


APEX = 0.08  # slant, and the chart's middle


def cone(p, xp=np):
    """Half apex angle 30 degrees; chart: apex + slant (cos, sin)."""
    x, y = p[..., 0] - APEX, p[..., 1] - APEX
    s = xp.sqrt(x * x + y * y + 1e-24)
    return xp.stack([x * 0.5, y * 0.5, s * np.cos(np.pi / 6)], -1)


def hand():
    """A left hand, 120 x 160 mm (palm down): outline and 40 electrodes."""
    pts = [
        (38, 0),
        (86, 0),
        (93, 18),
        (97, 35),
        (102, 50),
        (110, 62),
        (119, 76),
        (120, 84),
        (113, 89),
        (105, 84),
        (97, 74),
        (92, 70),
        (92, 84),
        (93, 108),
        (93, 130),
        (91, 139),
        (84, 143),
        (77, 139),
        (75, 130),
        (74, 106),
        (72, 90),
        (70, 91),
        (70, 112),
        (69, 138),
        (68, 152),
        (61, 160),
        (53, 157),
        (50, 150),
        (50, 124),
        (50, 92),
        (48, 91),
        (45, 110),
        (43, 130),
        (40, 142),
        (33, 147),
        (26, 143),
        (25, 135),
        (27, 112),
        (29, 90),
        (27, 88),
        (22, 101),
        (18, 113),
        (13, 120),
        (6, 119),
        (1, 112),
        (2, 102),
        (8, 86),
        (14, 70),
        (19, 52),
        (24, 30),
        (31, 12),
    ]
    el = [
        (44, 8),
        (62, 8),
        (80, 8),
        (38, 24),
        (56, 24),
        (74, 24),
        (88, 26),
        (32, 40),
        (48, 40),
        (64, 40),
        (80, 40),
        (94, 44),
        (27, 56),
        (42, 56),
        (57, 56),
        (72, 56),
        (88, 56),
        (102, 62),
        (22, 72),
        (37, 73),
        (52, 73),
        (67, 73),
        (82, 72),
        (111, 77),
        (14, 90),
        (38, 88),
        (60, 88),
        (83, 86),
        (9, 110),
        (36, 104),
        (60, 104),
        (84, 102),
        (34, 120),
        (60, 121),
        (84, 118),
        (33, 137),
        (59, 136),
        (84, 133),
        (60, 150),
        (17, 100),
    ]
    return np.array(pts) * 1e-3, np.array(el) * 1e-3


def sheets():
    """name -> dict(outline, holes, xy, size, surface name or None, kind)."""
    out = {}
    c = np.array([0.05, 0.05])
    out["disc"] = dict(
        outline=circle(c, 0.05, 720),
        holes=[],
        xy=np.concatenate(
            [ring(c, 0.05, 16), ring(c, 0.015, 2, 0.3), ring(c, 0.03, 6, 0.2)]
        ),
        size=[0.1, 0.1],
    )
    L = np.array([[0, 0], [0.16, 0], [0.16, 0.08], [0.08, 0.08], [0.08, 0.16], [0, 0.16]])
    g = grid(8, 8, 0.02, 0.01, 0.01)
    out["L"] = dict(outline=L, holes=[], xy=g[~((g > 0.08).all(1))], size=[0.16, 0.16])
    sq = np.array([[0, 0], [0.16, 0], [0.16, 0.16], [0, 0.16]])
    hole = circle([0.08, 0.08], 0.025, 96)
    keep = np.linalg.norm(g - 0.08, axis=1) > 0.025 + 0.004
    out["hole"] = dict(outline=sq, holes=[hole], xy=g[keep], size=[0.16, 0.16])
    hexa = np.array([0.08, 0.07]) + 0.08 * np.stack(
        [np.cos(np.pi / 3 * np.arange(6)), np.sin(np.pi / 3 * np.arange(6))], -1
    )
    hexa[:, 1] += 0.08 * np.sin(np.pi / 3) - 0.07
    mid = hexa.mean(0)
    el = [
        mid + 0.023 * np.array([q + r / 2, r * np.sqrt(3) / 2])
        for q in range(-3, 4)
        for r in range(-3, 4)
        if abs(q + r) <= 3
    ]
    hexa = np.maximum(hexa, 0)
    out["hexagon"] = dict(
        outline=hexa, holes=[], xy=np.array(el), size=hexa.max(0).tolist()
    )
    # The same round skin, read at its edge alone.
    out["rim"] = dict(out["disc"], xy=out["disc"]["xy"][:16])
    cy = np.array([[0, 0], [CW, 0], [CW, 0.1], [0, 0.1]])
    out["cylinder"] = dict(
        outline=cy,
        holes=[],
        xy=grid(6, 5, 0.02, CW / 2 - 0.05, 0.01),
        size=[CW, 0.1],
        surface="cylinder",
    )
    c = np.array([APEX, APEX])
    out["cone"] = dict(
        outline=circle(c, 0.08, 720),
        holes=[],
        xy=np.concatenate([ring(c, 0.035, 8, 0.1), ring(c, 0.065, 16, 0.1)]),
        size=[0.16, 0.16],
        surface="cone",
        points=[c],
    )
    out["rectangle"] = dict(outline=sq, holes=[], xy=g, size=[0.16, 0.16])
    h, e = hand()
    out["hand"] = dict(outline=h, holes=[], xy=e, size=h.max(0).tolist())
    for name, d in out.items():
        d.setdefault("surface", None)
        kinds = {
            "disc": "disc",
            "rim": "disc",
            "cone": "disc",
            "rectangle": "rectangle",
            "cylinder": "rectangle",
        }
        d["kind"] = kinds.get(name, "polygon")
    return out


SURFACES = {"cylinder": cylinder, "cone": cone}


def pixels(size: np.ndarray) -> tuple[np.ndarray, tuple[int, int]]:
    """The centres of a raster (n, 2), m, and its shape: shapes' overlap is told on it."""
    shape = tuple(int(round(RASTER * s / max(size))) for s in size)
    at = np.stack(np.indices(shape), -1).reshape(-1, 2) + 0.5
    return at / shape * np.asarray(size), shape
