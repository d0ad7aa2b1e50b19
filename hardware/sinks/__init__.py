"""Where contacts go while they are live: other programs, over the network or to files."""
