"""The live loop's ordinary way in C: slots from a wire into a step that runs as C.

The room knows a wire's bytes, a ring's rows and a step's call. Whatever is not ordinary, it
gives back to Python.
"""

from tomojax.hardware.loop.in_c._loop import loop_in_c as loop_in_c, LoopInC as LoopInC
