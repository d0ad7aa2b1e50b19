"""Recordings of pairs of electrodes: their files, and what they hold. Loads no JAX."""
