"""Skins of other outlines, and their voltages by a model that is not the library's.

`Peer` has quadratic elements on an unstructured mesh, electrodes as one unknown each, and
an assembly of its own; against closed forms its resistances are right to 1e-5 to 1e-4. It
needs the packages triangle and shapely (`_peer`, `_scenes`). The room knows nothing of
methods.
"""

from bench.skins._sheets import sheets as sheets, SURFACES as SURFACES


def make_scenes(*args, **kwargs):
    """Writes a skin's scenes; loads what makes them."""
    from bench.skins._scenes import make_scenes

    return make_scenes(*args, **kwargs)
