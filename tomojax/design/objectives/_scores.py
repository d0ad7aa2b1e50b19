"""Computes errors of place on rigs that are not nominal, for any slots, without fits.

`points` takes slots' errors for independent; mostly they are the sheet's, which all slots
share. To first order a contact is found off its place by F⁻¹ Σ_l w_l h_l. The score h_l of
slot l is the pull of a rig's voltages, less nominal voltages.
"""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.design.objectives._contacts import Contact, without_current
from tomojax.design.objectives._information import AbstractObjective, place_prior
from tomojax.design.objectives._rigs import differences, disc_shares, GAIN
from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts import Noise, slot_weights, solve_small, whitened
from tomojax.kernels.sheet import Grounds, volts_per_ampere
from tomojax.methods import noise_of
from tomojax.sensor import converter_of, Sensor

# Rigs that are simulated.
_RIGS = 16


class SimulatedPlaceError(AbstractObjective):
    """The rms error of a contact's place over simulated rigs, m.

    The error is √(mean_r |F⁻¹ Σ_l w_l h_lr|²), F = F₀ + Σ_l w_l F_l as in
    `PlaceInformation`. The error is not convex in the weights: no bound exists.
    """

    information: Float[Array, "P L 3 3"]  # of x, y (per unit) and size
    scores: Float[Array, "P L R 3"]
    length: Float[Array, ""]  # the unit, m
    unit: ClassVar[str] = "m"  # pyright: ignore

    @property
    def slots(self) -> int:
        return self.information.shape[1]

    def alone(self, k: Array) -> "SimulatedPlaceError":
        one = self.information[k][None], self.scores[k][None]
        return replace(self, information=one[0], scores=one[1])

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        told = jnp.einsum("l,plij->pij", weights, self.information, precision="highest")
        pull = jnp.einsum("l,plri->pir", weights, self.scores, precision="highest")
        known = told + place_prior(self.length)
        off = solve_small(known, pull)[:, :2] * self.length
        return jnp.sqrt((off**2).sum(1).mean(1))


def simulated_place_error(
    sensor: Sensor, contact: Contact, places: Float[Array, "P 2"]
) -> SimulatedPlaceError:
    """Makes the objective of discs at `places` on rigs like those of `simulate_scenes`."""
    m, noise, sheet = sensor.electrode_count, noise_of(sensor), contact.sheet
    inside = disc_shares(sensor, np.asarray(places), float(sheet.size))
    keys = jax.random.split(jax.random.key(0), _RIGS)
    more = [(d.electrodes, d.elements @ inside) for d in differences(sensor, keys)]
    more_ee, more_ek = (jnp.stack(part) for part in zip(*more))  # (R, M, M), (R, M, P)
    gain, hiss = jax.random.split(jax.random.key(1))
    gains = GAIN * jax.random.normal(gain, (_RIGS, m), sensor.dtype)
    hisses = jax.random.normal(hiss, (m, _RIGS, m), sensor.dtype)
    hisses = converter_of(sensor).noise * hisses

    rigs = more_ee, more_ek.transpose(2, 0, 1), gains, hisses
    told, scores = _scores(contact, noise, places, *rigs)
    return SimulatedPlaceError(told, scores, sheet.unit)


@jax.jit
def _scores(
    contact: Contact,
    noise: Noise,
    places: Float[Array, "P 2"],
    more_ee: Float[Array, "R M M"],
    more_ek: Float[Array, "P R M"],
    gains: Float[Array, "R M"],
    hisses: Float[Array, "M R M"],
) -> tuple[Float[Array, "P L 3 3"], Float[Array, "P L R 3"]]:
    """Computes F_l and h_l at places, by rigs' resistances less the nominal ones."""
    grounds = jnp.arange(len(hisses))

    def one(place: Array, ek: Array, ground: Array) -> tuple[Array, Array]:
        columns, current = contact.columns(place, ground), contact.current(place, ground)
        slot = ground[None]
        more = jax.vmap(lambda r, ee: volts_per_ampere(Grounds(ee, 0.0), r, slot))
        more = more(ek, more_ee)
        off = current * more[:, 0]
        off = off + gains * columns[0] + hisses[ground]
        read = jnp.ones(len(grounds), bool)
        weights = slot_weights(noise, columns[0], read)
        columns = whitened(weights, columns)
        return score(columns, columns, whitened(weights, off))

    every = jax.vmap(one, (None, None, 0))
    return jax.lax.map(lambda x: every(x[0], x[1], grounds), (places, more_ek))


def score(
    columns: Float[Array, "n M"], seen: Float[Array, "n M"], off: Float[Array, "R M"]
) -> tuple[Float[Array, "k k"], Float[Array, "R k"]]:
    """Computes F_l and h_l of a slot's `columns` J (the first is the free current's) and
    errors `off`, V; `seen` is J·N⁻¹."""
    gram, right = matmul(columns, seen.T), matmul(off, seen.T)
    return without_current(gram), right[:, 1:] - right[:, :1] * (gram[1:, 0] / gram[0, 0])
