"""Skins of other outlines, and their voltages by a model that is not the library's.

`Peer` has quadratic elements on an unstructured mesh, electrodes as one unknown each, and
an assembly of its own; against closed forms its resistances are right to 1e-5 to 1e-4. It
needs the packages triangle and shapely, as `scenes` does. The room knows nothing of
methods.
"""

from bench.skins._sheets import (
    KINDS as KINDS,
    pixels as pixels,
    sheets as sheets,
    SURFACES as SURFACES,
)
