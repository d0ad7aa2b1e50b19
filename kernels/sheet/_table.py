"""Holds the table of transfer resistances, from which all else follows by arithmetic."""

from typing import NamedTuple

from jaxtyping import Array, Float


class Resistances(NamedTuple):
    """Transfer resistances of a sheet, Ω, for M electrodes and K elements.

    R is a symmetric inverse of the sheet's stiffness on balanced currents; p_e reads and
    feeds electrode e, b_k element k. Only differences that balance are physical. Adding c_e
    + c_f to `electrodes`, c_e + d_k to `elements` and 2·d_k to `own` changes no voltage.
    `centred` makes the choice unique.
    """

    electrodes: Float[Array, "M M"]  # R_ee' = p_eᵀ R p_e'
    elements: Float[Array, "M K"]  # R_ek = p_eᵀ R b_k
    own: Float[Array, " K"]  # R_kk = b_kᵀ R b_k


def centred(table: Resistances) -> Resistances:
    """Shifts the table so that the mean potential of the electrodes is zero.

    R ← (I − 1mᵀ) R (I − m1ᵀ), m the mean over the electrodes. The values are then small,
    which float32 needs, and do not depend on the route that made them.
    """
    ee, ek, kk = table
    row, column = ee.mean(0), ek.mean(0)
    mean = row.mean()
    return Resistances(
        ee - row[:, None] - row[None, :] + mean,
        ek - row[:, None] - column[None, :] + mean,
        kk - 2 * column + mean,
    )
