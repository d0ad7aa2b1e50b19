"""Finds what conducts less or more inside a body that electrodes surround, such as a tank.

The room knows the complete electrode model, and levels of conductance.
"""
