"""Studies of the library, and simulated rigs; a checkout has them, the wheel does not.

The studies are speed against accuracy (`frontier`) and where methods fail (`stability`). A
resistor network and finite elements simulate the rigs, not the library's own model.
Benchmarks, tests and notebooks import the package, and so do two commands.
"""
