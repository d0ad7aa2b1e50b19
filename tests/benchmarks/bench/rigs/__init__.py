"""Rigs to try methods on, with more errors than methods assume; two models of them.

A rig is a description (`Rig`), drawn from stated distributions by a seed. A model makes the
rig's exact voltages; the two models share no code. The room knows nothing of methods.
"""

from bench.rigs._elements import Elements as Elements
from bench.rigs._family import (
    draw_touch as draw_touch,
    FAMILY as FAMILY,
    JUDGING as JUDGING,
    lone_contacts as lone_contacts,
    LoneContacts as LoneContacts,
    make_rig as make_rig,
)
from bench.rigs._networked import network_of as network_of
from bench.rigs._rig import Chain as Chain, draw_rig as draw_rig, Rig as Rig
from bench.rigs._shapes import Touch as Touch
from bench.rigs._strokes import (
    draw_strokes as draw_strokes,
    GLYPHS as GLYPHS,
    Strokes as Strokes,
    THINGS as THINGS,
)
