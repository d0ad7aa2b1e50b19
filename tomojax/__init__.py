"""Differentiable reconstruction for tomographic tactile sensors.

The names of `__init__.pyi` are imported when they are first used (SPEC 1), so that a
command starts before JAX does. This file must not import the package's folders. A
process that cannot run JAX is told so. In a
checkout the folders `kernels` and `hardware` here are links to those beside this one.
"""

import lazy_loader as _lazy

from tomojax._forked import refuse_child as _refuse_child

_refuse_child()

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
