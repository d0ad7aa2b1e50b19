"""Studies: Table I, speed against accuracy, where methods fail; and simulated rigs.

A resistor network and finite elements simulate the rigs, not this package's own model. Only
the command line, notebooks and tests import the studies; no study is part of the library.
"""
