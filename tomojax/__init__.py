"""Differentiable reconstruction for tomographic tactile sensors.

The names of `__init__.pyi` are imported when they are first used (SPEC 1), so that a
command starts before JAX does. This file must not import the package's folders.
"""

from pathlib import Path as _Path

import lazy_loader as _lazy

# In a checkout `kernels/` and `hardware/` lie beside this folder, not inside it.
if (_Path(__file__).parent.parent / "kernels" / "__init__.py").is_file():
    __path__.append(str(_Path(__file__).parent.parent))

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
