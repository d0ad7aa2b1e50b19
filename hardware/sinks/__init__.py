"""Where contacts go while they are live: other programs, over the network or to files.

Each sink is a process of its own that reads the ring: the loop waits for none.
"""
