"""Recordings in the formats of other tools.

Each module reads one kind of file into a `Recording`.
"""
