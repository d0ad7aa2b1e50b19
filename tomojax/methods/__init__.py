"""The ladder of models: from the voltages of a frame to contacts and an image.

Each method has a file of its own and keeps one contract. `method` finds a method by name;
`Batch` applies a method to many frames. The folder knows nothing of files, nor of the next
ground.

The names of `__init__.pyi` are imported when they are first used: reading a file alone
waits for no JAX.
"""

from tomojax._require import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
