"""Reads triangles from files of meshes, by meshio."""

import contextlib
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tomojax._require import library, require

# Half a million triangles of a text file take 150 MB.
_MOST_BYTES = 1 << 29

# Vertices nearer than this part of the mesh's size are one: STL has float32, and each
# triangle its own corners.
_SAME = 1e-6


def read_triangles(
    path: Path, scale: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Reads vertices, m, and triangles; quadrangles are halved, vertices of a place merged.

    **Raises:** `ValueError` for a file that is none or has no triangles.
    """
    meshio: Any = library("meshio", "mesh")
    require(path.is_file(), f"{path}", "no file", "a mesh")
    size = path.stat().st_size
    require(size <= _MOST_BYTES, f"{path}", f"{size} bytes", f"{_MOST_BYTES} at most")
    require(0 < scale < np.inf, "scale", scale, "m per unit of the file")
    try:
        # meshio prints what is wrong, warns of its own code, and exits.
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            with warnings.catch_warnings(action="ignore"):
                mesh = meshio.read(path)
        points = scale * np.asarray(mesh.points, float)
        blocks = [np.asarray(b.data) for b in mesh.cells if b.type in ("triangle", "quad")]
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path}: not a mesh that meshio reads ({error!r})") from None
    kinds = sorted({block.type for block in mesh.cells})
    require(blocks, f"{path}", f"only {kinds}", "triangles")
    halves = [
        b[:, some] for b in blocks for some in ([0, 1, 2], [0, 2, 3])[: b.shape[1] - 2]
    ]
    triangles = np.concatenate(halves)
    fits = points.ndim == 2 and points.shape[1] in (2, 3) and np.isfinite(points).all()
    inside = (
        fits and triangles.size and 0 <= triangles.min() <= triangles.max() < len(points)
    )
    require(inside, f"{path}", "corners without places", "triangles")
    cell = _SAME * np.ptp(points[triangles.ravel()], 0).max() or 1.0
    _, first, which = np.unique(np.round(points / cell), True, True, axis=0)
    triangles = which.reshape(-1)[triangles]
    whole = (triangles != np.roll(triangles, 1, 1)).all(1)  # more than a line
    return points[first], triangles[whole]
