"""`shape`: finds where an object touches, as a field of two levels, in the exact model.

`described` reads contacts and flags off a fitted shape.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax._programs import kept
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import no_contacts, read_regions
from tomojax.methods._contract import bits_of, Estimate, judged, Part
from tomojax.methods._rows import empty_rows, Rows
from tomojax.methods.shapes._model import (
    AbstractShape,
    Before,
    CELLS,
    FittedShape,
    PreparedShape,
)

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


class ImageShape(AbstractShape):
    """The likeliest shape: g = level·logistic(f), f a Gaussian field beforehand.

    The image is g, S/m²; rows also have the probability that a pixel touches.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "shape", grid=16)
    >>> isinstance(method, tx.methods.ImageShape), method.image_unit
    (True, 'S/m^2')
    >>> bar = tx.Bar([0.04, 0.04], 0.04, 0.014, 0.0, 0.3)
    >>> volts = np.asarray(tx.voltages(sensor, bar, [0, 3, 12, 15]))
    >>> rows = tx.Batch(method, 1.0)(volts[None], np.array([[0, 3, 12, 15]]))
    >>> found = rows.touch[0] > 0.5  # the probability that a pixel touches
    >>> bool(0.7 < found.sum() * 0.005**2 / (0.04 * 0.014) < 1.5)
    True
    """

    image_unit: ClassVar[str] = "S/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    stands_out: ClassVar[float] = 3.3
    cells_per_diameter: ClassVar[int] = CELLS
    padded: ClassVar[bool] = False
    seconds_per_slot: ClassVar[float] = 1.5e-2  # 29 ms alone, 110 ms for ten
    films: ClassVar[bool] = True

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        nx, ny = self.shape
        return super().sizes(contacts, images) | ({"tx": nx, "ty": ny} if images else {})

    def estimate(
        self, prepared: PreparedShape, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        """Fits the shape; the image can be differentiated by the voltages.

        The derivative holds each place's level constant.
        """
        fitted = self.fitted(prepared, voltages, self.nothing_before(), follow=True)
        return described(self, fitted, fitted.conductance, count)

    def block(self, prepared: PreparedShape, part: Part, count: int, images: bool) -> Rows:
        """Estimates frames one by one; a film's frame goes on from the frame before."""
        volts, films = part.voltages, part.films
        rows = empty_rows(len(volts), self.sizes(count, images))
        before = nothing = self.nothing_before()
        for k, v in enumerate(volts):
            follows = films is not None and k > 0 and films[k] == films[k - 1]
            start = before if follows else nothing
            row, before = _row(self, prepared, v, count, images, start)
            rows.put(k, row)
        return rows


@kept
def _row(
    method: ImageShape,
    prepared: PreparedShape,
    voltages: Float[Array, "S M"],
    count: int,
    images: bool,
    before: Before,
) -> tuple[Rows, Before]:
    fitted = method.fitted(prepared, voltages, before)
    estimate = described(method, fitted, fitted.conductance, count)
    return judged(method, estimate, voltages, images), fitted.next
