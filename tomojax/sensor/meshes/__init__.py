"""Takes sheets from elsewhere: triangles become charts and surfaces, tables resistances.

This room knows triangles and grids. The room knows nothing of sensors.
"""
