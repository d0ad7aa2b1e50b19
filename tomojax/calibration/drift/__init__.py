"""Follows a calibration over time: drift of zeros and gains, and whether it still fits.

The folder follows a rig with the calibration's own model. The folder finds no new sheet or
places.
"""
