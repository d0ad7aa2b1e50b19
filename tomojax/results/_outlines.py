"""Writes the outlines of touching objects, from results of `shape`: GeoJSON, or SVG."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Integer

from tomojax._require import require
from tomojax._whole import whole
from tomojax.results.loading import LoadedResults

_ROWS = 256  # read at once
_HALF = 0.5  # the probability at an outline

# Outlines of fewer pixels are noise's.
_LEAST = 1.5

KINDS = (".geojson", ".json", ".svg")


class Outline(NamedTuple):
    """One object: a region where the probability of touch is a half or more.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> x = (np.arange(32) + 0.5) / 32 * 0.16
    >>> away = np.hypot(x[:, None] - 0.08, x - 0.06)
    >>> touch = 1 / (1 + np.exp((abs(away - 0.03) - 0.01) / 0.001))  # a ring
    >>> (found,) = tx.results.outlines_of(touch, (0.16, 0.16))
    >>> isinstance(found, tx.results.Outline), len(found.rings)  # outside, and a hole
    (True, 2)
    >>> print(np.round(1e3 * found.centroid))  # mm
    [80. 60.]
    """

    rings: tuple[Float[np.ndarray, "n 2"], ...]  # m, closed; the outer one, then holes
    area: float  # m²
    centroid: Float[np.ndarray, "2"]  # m
    axes: tuple[float, float]  # half axes of the ellipse with the same moments, m
    angle: float  # of the longer one from x, rad in [0, π)
    conductance: float  # S; NaN without an image of it


# Of each row its number, its time in s, and its outlines.
_Found = Iterator[tuple[int, float, list[Outline]]]


def outlines_of(
    touch: Float[np.ndarray, "nx ny"],
    size: Any,
    image: Float[np.ndarray, "nx ny"] | None = None,
) -> list[Outline]:
    """Finds the objects of one image of probabilities, the largest first.

    **Arguments:** `size` of the sheet, m; `image` S/m², for the conductance of each.
    **Raises:** `ValueError` for an image that is not finite, or no sheet's size.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> touch = np.zeros((32, 32))
    >>> touch[8:16, 4:28] = 1
    >>> (bar,) = tx.results.outlines_of(touch, (0.16, 0.16))
    >>> print(f"{1e6 * bar.area:.0f} mm², {np.degrees(bar.angle):.0f}°")
    4788 mm², 90°
    """
    from contourpy import contour_generator, FillType

    touch, sides = np.asarray(touch, float), np.asarray(size, float)
    require(touch.ndim == 2, "touch", f"shape {touch.shape}", "an image (nx, ny)")
    require(bool(np.isfinite(touch).all()), "touch", "NaN", "probabilities")
    fine = sides.shape == (2,) and bool((sides > 0).all())
    require(fine, "size", repr(size), "two lengths above 0, m")
    cell = sides / touch.shape
    # The sheet's rim is half a pixel outside the outermost pixels' centres.
    wide = np.pad(touch, 1, "edge")
    x, y = (
        np.concatenate([[0], (np.arange(n) + 0.5) * c, [s]])
        for n, c, s in zip(touch.shape, cell, sides)
    )
    made = contour_generator(x, y, wide.T, fill_type=FillType.OuterOffset)
    label: Any = scipy.ndimage.label(touch > _HALF, np.ones((3, 3)))
    label = label[0]
    found = []
    for points, offsets in zip(*made.filled(_HALF, np.inf)):
        ends = np.asarray(offsets)
        rings = tuple(points[a:b] for a, b in zip(ends[:-1], ends[1:]))
        area, centroid, moments = _moments(rings)
        if area < _LEAST * cell.prod():
            continue
        values, turn = np.linalg.eigh(moments)
        angle = float(np.arctan2(turn[1, 1], turn[0, 1])) % np.pi
        long, short = 2 * np.sqrt(np.maximum(values[::-1], 0))
        siemens = _within(rings[0], label, image, cell)
        found.append(
            Outline(rings, area, centroid, (float(long), float(short)), angle, siemens)
        )
    # What touches by less than half is the rims'.
    told = sum(one.conductance for one in found)
    if image is not None and told > 0:
        part = float(np.sum(image)) * cell.prod() / told
        found = [one._replace(conductance=one.conductance * part) for one in found]
    return sorted(found, key=lambda one: -one.area)


def _moments(rings: tuple[np.ndarray, ...]) -> tuple[float, np.ndarray, np.ndarray]:
    """Computes area, centroid and central second moments per area; holes run backwards."""
    area, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    for ring in rings:
        a, b = ring[:-1], ring[1:]
        cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
        area += cross.sum() / 2
        first += ((a + b) * cross[:, None]).sum(0) / 6
        both = a[:, :, None] * a[:, None] + b[:, :, None] * b[:, None]
        mixed = a[:, :, None] * b[:, None] + b[:, :, None] * a[:, None]
        second += ((2 * both + mixed) * cross[:, None, None]).sum(0) / 24
    sign = 1 if area >= 0 else -1
    area = max(abs(area), 1e-30)
    centroid = sign * first / area
    return area, centroid, sign * second / area - np.outer(centroid, centroid)


def _within(
    outer: Float[np.ndarray, "n 2"],
    label: Integer[np.ndarray, "nx ny"],
    image: Float[np.ndarray, "nx ny"] | None,
    cell: Float[np.ndarray, "2"],
) -> float:
    """Computes the conductance of an outline's region, S."""
    if image is None:
        return float("nan")
    # Half a pixel inwards of the outline's pixels lies one of the region.
    at = np.clip((outer / cell).astype(int), 0, np.array(label.shape) - 1)
    counted = np.bincount(label[tuple(at.T)], minlength=label.max() + 1)
    if counted[1:].sum() == 0:
        return float("nan")
    return float(image[label == counted[1:].argmax() + 1].sum() * cell.prod())


def check_outlines(path: Path, method: str, images: bool) -> None:
    """Checks before any work that OUT can have outlines. **Raises:** `ValueError`."""
    kind = path.suffix.lower()
    require(kind in KINDS, f"{path}", f"the ending {kind!r}", ", ".join(KINDS))
    fits = method == "shape" and images
    text = f"method {method!r}, images {'on' if images else 'off'}"
    require(fits, "outlines", text, "method 'shape' with images")


def write_outlines(results: Path, out: Path) -> int:
    """Writes the outlines of all rows with a contact; returns the number of outlines.

    GeoJSON has each object's row, time, area, centroid, axes and conductance. Its lengths
    are m on the sheet, not on the Earth. SVG has a group for each row, in mm.
    **Raises:** `ValueError` for results without probabilities of touch.
    """
    with LoadedResults(results) as file:
        has = {"touch", "image", "contact_count"} <= set(file.names)
        require(has, f"{results}", "no image of touch", "results of --method shape")
        size = file.size()
    write = _svg if out.suffix.lower() == ".svg" else _geojson
    with whole(out) as part:
        return write(_rows(results, size), size, part)


def _rows(results: Path, size: np.ndarray) -> _Found:
    with LoadedResults(results) as file:
        names = ("t", "touch", "image", "contact_count")
        rows = (row for block in file.blocks(names, _ROWS) for row in zip(*block.values()))
        for k, (t, touch, image, count) in enumerate(rows):
            if count and np.isfinite(touch).all():
                yield k, float(t), outlines_of(touch, size, image)


def _geojson(rows: _Found, size: np.ndarray, out: Path) -> int:
    done = 0
    with out.open("w") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for row, t, found in rows:
            for k, one in enumerate(found):
                told = {
                    "row": row,
                    "t_s": t,
                    "object": k,
                    "area_m2": one.area,
                    "centroid_m": one.centroid.tolist(),
                    "half_axes_m": list(one.axes),
                    "angle_rad": one.angle,
                    "conductance_S": None if np.isnan(one.conductance) else one.conductance,
                }
                shape = {
                    "type": "Polygon",
                    "coordinates": [ring.round(6).tolist() for ring in one.rings],
                }
                feature = {"type": "Feature", "properties": told, "geometry": shape}
                file.write(("," if done else "") + "\n" + json.dumps(feature))
                done += 1
        file.write("\n]}\n")
    return done


def _svg(rows: _Found, size: np.ndarray, out: Path) -> int:
    done, (width, height) = 0, 1e3 * size
    with out.open("w") as file:
        file.write(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}mm" height="{height:g}mm">\n'
            f'<rect width="{width:g}" height="{height:g}" fill="none" stroke="grey" '
            'stroke-width="0.3"/>\n'
        )
        for row, t, found in rows:
            file.write(f'<g id="row-{row}" fill-rule="evenodd" fill-opacity="0.5">')
            file.write(f"<title>row {row}, {t:.4f} s</title>")
            for one in found:
                mm = [np.array([0, height]) + 1e3 * r * [1, -1] for r in one.rings]
                path = "".join(
                    "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in ring) + "Z" for ring in mm
                )
                file.write(f'<path d="{path}"/>')
                done += 1
            file.write("</g>\n")
        file.write("</svg>\n")
    return done
