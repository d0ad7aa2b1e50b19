"""Takes sheets from elsewhere: triangles become charts and surfaces, tables resistances.

This room knows triangles and grids. The room knows nothing of sensors.
"""

from tomojax.sensor.meshes._grid_surface import GridSurface
from tomojax.sensor.meshes._mesh_file import read_triangles
from tomojax.sensor.meshes._told import ToldSheet
from tomojax.sensor.meshes._triangles import chart_places, unroll, Unrolled

__all__ = [
    "chart_places",
    "GridSurface",
    "read_triangles",
    "ToldSheet",
    "unroll",
    "Unrolled",
]
