"""Reads contacts and flags off a fitted shape."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import no_contacts, read_regions
from tomojax.methods._contract import bits_of, Estimate
from tomojax.methods.shapes._model import AbstractShape, FittedShape

# A region is what touches by half, of what touches most.
_HALF = 0.5

# A region beyond those that are asked for is one more contact if it carries this part of
# what the first region carries.
_OTHERS = 0.1

# Highest voltage, in the converter's noise, that places a contact.
_FAINT = 30.0

# Where more than this part of what touches may as well not, the place is not told.
_VAGUE = 0.3

# Voltages above this part of the drive are not there without a contact, though all of them
# be alike (metal on the whole sheet), which an offset would explain as well.
_SURELY = 0.05

# A conductance per area is told until current enters an object within this part of a pitch
# of its rim: of metal only that it is metal can be known.
_RIM = 0.25


def described(
    model: AbstractShape, fitted: FittedShape, image: Float[Array, "nx ny"], count: int
) -> Estimate:
    """Reads each contact off a connected region that touches; sets the flags."""
    touch = model.touched(fitted.fit)
    doubt = (fitted.touch * (1 - fitted.touch)).sum()
    vague = doubt > _VAGUE * fitted.touch.sum()
    read = lambda carried: read_regions(  # noqa: E731
        touch, carried, model.cell, count + 1, _HALF
    )
    area = jnp.prod(model.cell)
    contacts, flow = read(fitted.conductance * area), read(fitted.current)
    # One more than are asked for says that there are others.
    more = contacts.current[count] > _OTHERS * contacts.current[0]
    # Their rims, which touch by less than half, are theirs as well.
    whole = [carried.sum() for carried in (fitted.conductance * area, fitted.current)]
    shares = [
        w * a.current / jnp.maximum(jnp.nansum(a.current), jnp.finfo(w.dtype).tiny)
        for w, a in zip(whole, (contacts, flow))
    ]
    contacts = contacts._replace(conductance=shares[0], current=shares[1])
    some = jnp.minimum(contacts.count, count)
    contacts = jax.tree.map(lambda a: a[:count] if a.ndim else a, contacts)
    told = jnp.where(fitted.seen, some, 0).astype(jnp.uint8)
    # What is not seen has no place.
    none = no_contacts(count, contacts.xy.dtype)
    contacts = tree_where(fitted.seen, contacts._replace(count=told), none)
    faint = fitted.seen & (fitted.highest < _FAINT * model.noise)
    squares = fitted.conductance.max() * model.sheet_resistance
    metal = squares * (_RIM * model.pitch) ** 2 > 1
    high = fitted.highest > _SURELY * jnp.abs(model.drive_voltage)
    flags = bits_of(
        ((fitted.cost > 1) | high & ~fitted.seen, Flag.HIGH_RESIDUAL),
        (more, Flag.CONTACTS_UNEXPLAINED),
        (fitted.seen & metal, Flag.CONDUCTANCE_UNCERTAIN),
        (faint | fitted.seen & vague, Flag.PLACE_UNCERTAIN),
    )
    return Estimate(
        contacts,
        image,
        fitted.residual,
        flags,
        by_electrode=fitted.by_electrode,
        touch=fitted.touch,
        deviation=fitted.deviation,
    )
