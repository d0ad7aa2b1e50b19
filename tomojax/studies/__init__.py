"""Studies: Table I, speed against accuracy, where methods fail; and a rig that is not ours.

Only the command line, notebooks and tests import them; no study is part of the library.
"""
