"""Draws scenes of each skin on rigs with errors, and keeps them in a folder."""

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.ops import nearest_points

from bench.rigs import draw_strokes, Strokes
from bench.skins._sheets import KINDS, pixels, SURFACES
from bench.skins.peer import draw_errors, Peer

# Contacts' radii, m, and conductances, S; a stroke's width, m, and S/m².
RADII, SIEMENS = (4e-3, 8e-3), (5e-6, 1e-4)
STROKE, PER_AREA = 0.014, (0.05, 1.0)
LETTERS = "ACEFHLSTU"


def spread(xy: np.ndarray, n: int, surface: Any) -> np.ndarray:
    """Grounds far apart: the two farthest, or from the middle one on the farthest next."""
    p = surface(xy) if surface else xy
    apart = np.linalg.norm(p[:, None] - p, axis=-1)
    if n == 2:
        return np.array(np.unravel_index(apart.argmax(), apart.shape))
    got = [int(np.linalg.norm(p - p.mean(0), axis=1).argmin())]
    while len(got) < n:
        got.append(int(apart[:, got].min(1).argmax()))
    return np.array(sorted(got))


def _level(strokes: Strokes) -> Any:
    return lambda p: -STROKE / 2 * strokes.depths(p.reshape(-1, 2)).max(0)


def draw_contacts(
    d: dict, count: int, rng: np.random.Generator, pitch: float, sheet: Any
) -> np.ndarray:
    """Contacts (count, 4) on the sheet, half a radius from its edge, 1.5 pitches apart."""
    surface = SURFACES.get(d["surface"])
    while True:
        out = []
        while len(out) < count:
            r, at = rng.uniform(*RADII), rng.uniform([0, 0], d["size"])
            point = shapely.Point(at)
            off_apex = d["surface"] != "cone" or np.linalg.norm(at - 0.08) > 2 * r
            if (
                sheet.contains(point)
                and sheet.boundary.distance(point) > r / 2
                and off_apex
            ):
                out.append([*at, r, 10 ** rng.uniform(*np.log10(SIEMENS))])
        found = np.array(out)
        q = surface(found[:, :2]) if surface else found[:, :2]
        apart = np.linalg.norm(q[:, None] - q, axis=-1) + np.diag([9.0] * count)
        if apart.min() >= 1.5 * pitch:
            return found


def draw_shape(
    d: dict, kind: str, rng: np.random.Generator, pitch: float, sheet: Any
) -> Strokes:
    """A bar of two pitches, or a letter of three and a half, whole on the sheet."""
    places, _ = pixels(d["size"])
    inside = shapely.contains_xy(sheet, *places.T)
    for tried in range(100_000):
        at, turn = places[inside][rng.integers(inside.sum())], rng.uniform(0, 2 * np.pi)
        per_area = 10 ** rng.uniform(*np.log10(PER_AREA))
        if kind == "bar":
            half = pitch * np.array([np.cos(turn), np.sin(turn)])
            strokes = Strokes((np.stack([at - half, at + half]),), (STROKE,), per_area)
        else:
            name = LETTERS[rng.integers(len(LETTERS))]
            strokes = draw_strokes(name, at, 3.5 * pitch, turn, per_area, STROKE)
        touched = strokes.inside(places)
        # Of a narrow sheet, as a finger, a part may be off it after many draws.
        if (touched & ~inside).sum() <= tried / 1000 * 0.02 * touched.sum():
            return strokes
    raise RuntimeError(f"no place for a {kind}")


def make_scenes(name: str, d: dict, folder: Path, seed: int, each: int, rigs: int) -> Path:
    """Writes one skin's scenes: `each` of each kind, rig by rig in turn."""
    surface = SURFACES.get(d["surface"])
    sheet = shapely.Polygon(d["outline"], d["holes"]).buffer(0)
    grounds = [spread(d["xy"], n, surface) for n in (10, 2)]
    kinds = np.repeat(KINDS, each)
    n, m = len(kinds), len(d["xy"])
    rng = np.random.default_rng(seed)
    volts, drawn, pitch = np.zeros((n, 12, m)), [], 0.0
    for k in range(rigs):
        errors = draw_errors(seed + 1 + k, m, d["size"])
        xy = d["xy"] + errors["move"]
        for e, at in enumerate(xy):  # an electrode of the rim stays on the sheet
            if not sheet.contains(shapely.Point(at)):
                xy[e] = nearest_points(sheet, shapely.Point(at))[0].coords[0]
        peer = Peer(
            d["outline"], d["holes"], xy, rho=errors["rho"], z=errors["z"],
            surface=surface, points=d.get("points", ()), h=2.5e-3, rim=32,
        )  # fmt: skip
        if not drawn:
            pitch = float(np.sqrt(peer.area.sum() / m))
            for kind in kinds:
                count = KINDS.index(kind) + 1
                draw = draw_contacts if count <= 3 else draw_shape
                what = count if count <= 3 else kind
                drawn.append(draw(d, what, rng, pitch, sheet))  # pyright: ignore
        for i in range(k, n, rigs):
            one = drawn[i]
            touch = [(_level(one), one.per_area)] if isinstance(one, Strokes) else one
            exact = peer.voltages(touch, np.concatenate(grounds))
            volts[i] = errors["noise"](exact * errors["gains"])
    at, shape = pixels(d["size"])
    places, masks = np.full((n, 3, 2), np.nan), np.zeros((n, *shape), bool)
    for i, one in enumerate(drawn):
        if isinstance(one, Strokes):
            masks[i] = (one.inside(at) & shapely.contains_xy(sheet, *at.T)).reshape(shape)
        else:
            places[i, : len(one)] = one[:, :2]
    path = folder / f"{name}.npz"
    np.savez_compressed(
        path, volts=volts, grounds10=grounds[0], grounds2=grounds[1], kinds=kinds,
        places=places, masks=masks, pitch=pitch, on=shapely.contains_xy(sheet, *at.T),
    )  # fmt: skip
    return path
