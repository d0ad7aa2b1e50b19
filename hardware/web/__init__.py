"""A page in the browser. It shows what is live, or results, and nobody else may see it.

A process beside the loop serves it on this machine alone.
"""
