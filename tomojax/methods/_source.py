"""`source`: finds the current that the object feeds into the sheet, slot by slot.

V^l = T^l s^l holds exactly for any contact (DESIGN: one slot is linear in the injected
current). One slot tells M − 1 of the M numbers that can be known of s. A scan's image is
the mean of its slots' images: the slots' currents differ, their places do not. (One image
fitted to all slots was off by 50 mm where a strong contact's currents differ. Scaling each
slot to the same current made the image no better than the mean.)
"""

from bisect import bisect_left
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import gaussian, matmul
from tomojax.kernels.flags import Flag
from tomojax.kernels.images import explained_by, read_contacts, strongest_first
from tomojax.kernels.sheet import Grounds, Slots
from tomojax.methods._contract import (
    AbstractMethod,
    bits_of,
    Estimate,
    Frame,
    highest_of,
)
from tomojax.methods._errors import noise_as
from tomojax.methods._maps import (
    A,
    centring,
    each_factors,
    factors_of,
    pixels_of,
    Shared,
    shared_maps,
    slots_left,
    strongest,
    tikhonov_operator,
)
from tomojax.sensor import Calibration, nominal_noise, Sensor

# What nominal values of sheet and electrodes leave unexplained of measured voltages: 0.9
# to 1.5 % on recorded scenes (notebooks/sensor_and_scenes.py).
_MODEL_ERROR = 0.015

# A peak stands out of that noise by this factor of its standard deviation; offsets do not
# average out over slots, so that no number of them lowers it.
_STANDS_OUT = 5.0

# Of an image, beside images of point sources where its contacts were read off: a simulated
# lone contact leaves 4 to 8 %, one of two or three that was missed, a bar, a palm 12 % and
# more.
_UNEXPLAINED = 0.14

# So many times that error may hide a further contact, of the highest peak.
_HIDES = 2.0

# Length over which an image is smooth beforehand, of the electrodes' pitch.
_SMOOTH = 0.375

# Slots that λ is chosen from, or that stand for all, up to so many electrodes.
_SLOTS = 64
_LARGE = 256

# Directions that a ground changes.
_CHANGED = 3

# λ/σ₁² where nothing ever touches.
_RELATIVE = 1e-4


class PreparedSource(NamedTuple):
    """Arrays for S slots with their good channels."""

    operators: Float[Array, "SM r"]  # coefficients of the mean image from the voltages
    columns: Float[Array, "pixels r"]  # coefficients of the mean image of a source there
    misfits: Float[Array, "S M M"]  # T A − I on the good channels
    imaging: Float[Array, "SM r"]  # the same for the image that is drawn
    scaled: Float[Array, "r pixels"]  # basis/√(diagonal of the resolution matrix)
    coarse: Float[Array, "r some"]  # the same at every pixel that `reach` is apart
    sharp: Float[Array, "nx ny"]  # 1/√(diagonal of the resolution matrix)
    lowest: Float[Array, ""]  # statistic that noise does not reach
    used: Bool[Array, "S M"]
    lam: Float[Array, ""]
    # Where grounds share arrays: a ground's columns are less by this product, (pixels, q)·
    # (q, r), and its `scaled` and `coarse`, then of the basis, lack the factors `sharp`.
    less: tuple[Array, Array] | None = None


class Source(AbstractMethod):
    """s^l = T^lᵀ(T^lT^lᵀ + λI)⁻¹V^l, in an orthonormal basis of T's row space (rank M).

    The minimum-norm image is highest at electrodes wherever the contact is. Contacts are
    read off s_k/√(resolution matrix)_kk, which without noise is highest at a lone point
    source exactly (sLORETA: Pascual-Marqui, Methods Find. Exp. Clin. Pharmacol. 24D,
    2002); their currents are sums of s.

    The image that is drawn is smooth beforehand: s = Gw, G a Gaussian, w as s above. Detail
    finer than the electrodes' pitch is not in the data. λI alone puts such detail where
    detail costs least, at electrodes. The highest pixel of lone contacts was then 13 mm off
    in one of ten, against 4 mm with G. The image of λI alone is narrower (35 mm against
    45).

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> isinstance(method, tx.methods.Source), method.image_unit
    (True, 'A/m^2')
    """

    image_unit: ClassVar[str] = "A/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore

    shape: tuple[int, int] = eqx.field(static=True)
    reach: tuple[int, int] = eqx.field(static=True)  # pixels around a peak that tell it
    cell: Float[Array, "2"]
    basis: Float[Array, "r pixels"]
    slots: Slots  # the law of T^l; it and the next two in float64 on the host
    shared: Float[np.ndarray, "rows r"]  # r̃Bᵀ: T^lBᵀ are its `factors`
    drawn: Float[np.ndarray, "rows r"]  # the same of TG, in a basis of its own
    drawn_scale: float  # |TGB'ᵀ|² of all slots, over |TBᵀ|²
    smoothed: Float[Array, "r pixels"]  # each row of that basis times G
    reading_noise: Float[Array, ""]
    error: Float[Array, ""]  # of the model, as a part of that of nominal values
    drive: Float[Array, ""]  # V
    grounded: Bool[np.ndarray, "L M"]
    inside: Bool[Array, "nx ny"] | None = None

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Source":
        """Makes the method for an image of `shape` pixels."""
        # Metal discs where the sensor leaves it open, as for `points`: they lower the
        # sheet's effective resistance, and currents are in proportion to that.
        if sensor.electrode_shunt is None:
            sensor = replace(sensor, electrode_shunt=1.0)
        pixels = pixels_of(sensor, shape)
        # Half of the square that an electrode has to itself, as a Gaussian.
        length = _SMOOTH * sensor.mean_pitch / np.asarray(pixels.cell, float)
        noise, drive = nominal_noise(sensor), float(sensor.drive_voltage)
        shared, grounded = shared_maps(pixels)
        made = cls.from_shared(shared, grounded, shape, pixels.cell, length, noise, drive)
        if pixels.inside is None:
            return made
        # Rounding off the sheet, divided by its own spread, had peaks there.
        there = pixels.inside.ravel()
        basis, smoothed = (jnp.where(there, a, 0) for a in (made.basis, made.smoothed))
        return replace(made, inside=pixels.inside, basis=basis, smoothed=smoothed)

    @classmethod
    def from_shared(
        cls,
        maps: Shared,
        grounded: Bool[np.ndarray, "L M"],
        shape: tuple[int, int],
        cell: Array,
        length: Float[np.ndarray, "2"] | None = None,
        noise: float = 0.0,
        drive: float = np.inf,
    ) -> "Source":
        """Makes the method of any T^l; the image is smooth over `length` pixels; `noise` V.

        Currents flow out of the object for a `drive` above 0 V, into it below.
        `grounded` electrodes of each slot tell of their path alone.
        """
        dtype = cell.dtype
        sides, reach = [np.eye(n) for n in shape], (2, 2)
        if length is not None:
            # Half of a pitch.
            near = np.maximum(1, np.round(0.5 / _SMOOTH * np.asarray(length))).astype(int)
            reach = int(near[0]), int(near[1])
            sides = [np.asarray(gaussian(n, jnp.asarray(w))) for n, w in zip(shape, length)]
            sides = [side / np.linalg.norm(side, axis=1)[:, None] for side in sides]
        images = maps.rows.reshape(-1, *shape)
        smooth = np.einsum("mxy,xi,yj->mij", images, *sides, optimize=True)
        basis, shared = maps.basis()
        drawn, drawn_shared = maps._replace(rows=smooth.reshape(len(images), -1)).basis()
        some = _some(grounded)
        both = (each_factors(maps.slots, a, some) for a in (drawn_shared, shared))
        above, below = (sum((one**2).sum() for one in a) for a in both)
        rows = drawn.astype(dtype).astype(float).reshape(-1, *shape)
        smoothed = np.einsum("rij,xi,yj->rxy", rows, *sides, optimize=True)
        return cls(
            shape=shape,
            reach=reach,
            cell=cell,
            basis=jnp.asarray(basis, dtype),
            slots=maps.slots,
            shared=shared,
            drawn=drawn_shared,
            drawn_scale=float(above / below),
            smoothed=jnp.asarray(smoothed.reshape(drawn.shape), dtype),
            reading_noise=jnp.asarray(noise, dtype),
            error=jnp.ones((), dtype),
            drive=jnp.asarray(drive, dtype),
            grounded=grounded,
        )

    def factors(self, which: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n M r"]:
        """Computes T^lBᵀ of some slots, on the host."""
        return factors_of(self.slots, self.shared, np.asarray(which))

    def all_factors(self) -> Float[Array, "L M r"]:
        """Computes T^lBᵀ of all slots."""
        return jnp.asarray(self.factors(np.arange(len(self.grounded))), self.basis.dtype)

    def calibrated(self, calibration: Calibration) -> "Source":
        noise = noise_as(calibration, self.noise)
        error = jnp.asarray(calibration.error, self.error.dtype)
        return replace(self, reading_noise=noise, error=error)

    @property
    def drive_sign(self) -> Float[Array, ""]:
        return jnp.sign(self.drive)

    @property
    def highest(self) -> Float[Array | np.ndarray, ""]:
        return highest_of(self.drive)

    @property
    def noise(self) -> Float[Array, ""]:
        return self.reading_noise

    def scale(self) -> float:
        factors = each_factors(self.slots, self.shared, _some(self.grounded))
        return float(np.mean([strongest(a) for a in factors]) ** 2)

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Returns the λ that leaves the residual that nominal values leave in any case."""
        # A scan may begin before its contact: those slots have nothing to say.
        highest = [np.abs(frame.voltages).max() for frame in frames]
        enough = max(highest, default=0.0) / 2
        slots = [
            (v.astype(float), int(ground), good)
            for frame in frames
            for v, ground, good in zip(*frame)
            if good.any() and np.abs(v).max() >= enough
        ]
        if not slots:
            return _RELATIVE * self.scale()
        some = slots[:: max(1, len(slots) // _slots(self.electrode_count))]
        return float(np.exp(np.median([self._log_lambda(*slot) for slot in some])))

    def _log_lambda(
        self, v: Float[np.ndarray, " M"], ground: int, good: Bool[np.ndarray, " M"]
    ) -> float:
        """Returns ln λ where a slot's misfit is what noise and nominal values leave."""
        noise, error = float(self.noise), _MODEL_ERROR * float(self.error)
        target = good.sum() * noise**2 + error**2 * (v[good] @ v[good])
        centre = centring(good, self.grounded[ground])
        v, rows = centre @ v, centre @ self.factors(np.array([ground]))[0]
        lam = max(strongest(rows) ** 2, 1e-30) * np.logspace(-9, 0, 37)
        square, unit = rows @ rows.T, np.eye(len(rows))

        def misfit(k: int) -> float:
            rest = lam[k] * np.linalg.solve(square + lam[k] * unit, v)
            return float(max(rest @ rest, 1e-300))

        # The misfit grows with λ: a few systems take less time than singular values.
        above = bisect_left(range(len(lam)), target, key=misfit)
        both = np.clip([above - 1, above], 0, len(lam) - 1)
        ends = np.log([misfit(int(k)) for k in both])
        return float(np.interp(np.log(max(target, 1e-300)), ends, np.log(lam[both])))

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedSource:
        basis, dtype = np.asarray(self.basis, float), self.basis.dtype
        lam = min(lam, 1e-3 * float(np.finfo(dtype).max))  # an image of 0 either way
        (slots, m), rank, drawn_rank = good.shape, len(basis), self.drawn.shape[1]
        operators, imaging = (np.zeros((slots, m, n), dtype) for n in (rank, drawn_rank))
        misfits = np.zeros((slots, m, m), dtype)
        through, gain = np.zeros((2, rank, rank))
        there = np.flatnonzero(good.any(1))
        count = max(1, len(there))
        # Images are of currents in the drive's direction.
        forward = float(self.drive_sign) / count
        for k in there:
            centre = centring(good[k], self.grounded[grounds[k]])
            rows = centre @ self.factors(grounds[k : k + 1])[0]
            operator = tikhonov_operator(rows, lam)
            drawn = centre @ factors_of(self.slots, self.drawn, grounds[k : k + 1])[0]
            operators[k] = forward * operator.T
            imaging[k] = forward * tikhonov_operator(drawn, lam * self.drawn_scale).T
            misfits[k] = rows @ operator - centre
            through += operator @ rows
            gain += operator @ operator.T
        columns = (through @ basis).T
        spread = np.maximum((columns * basis.T).sum(1), 1e-30)
        noise = ((gain @ basis) * basis).sum(0)
        lowest = _STANDS_OUT * float(self.noise) * np.sqrt((noise / spread).max())
        columns /= count
        sharp = np.sqrt(count / spread)
        scaled = basis * sharp
        made = dict(
            operators=operators.reshape(slots * m, -1),
            columns=columns,
            misfits=misfits,
            imaging=imaging.reshape(slots * m, -1),
            scaled=scaled,
            coarse=self._apart(scaled),
            sharp=sharp.reshape(self.shape),
            lowest=np.asarray(lowest),
            used=good,
            lam=np.asarray(lam),
        )
        # JAX would compile a conversion for each shape.
        held: Any = {}
        for name, a in made.items():
            kind = bool if a is good else dtype
            held[name] = jnp.asarray(a.astype(kind, copy=False))
        return PreparedSource(**held)

    def prepare_each(self, good: Bool[np.ndarray, " M"], lam: float) -> list[Any]:
        each = super().prepare_each(good, lam)
        if not isinstance(self.slots, Grounds):
            return each

        def through(rows: np.ndarray, grounded: np.ndarray) -> np.ndarray:
            rows = centring(good, grounded) @ rows
            return tikhonov_operator(rows, lam) @ rows

        basis, dtype = np.asarray(self.basis, float), self.basis.dtype
        lam = min(lam, 1e-3 * float(np.finfo(dtype).max))  # as in `prepare`
        once = through(self.shared[:-1], np.zeros_like(good))
        columns, coarse = jnp.asarray((once @ basis).T, dtype), self._apart(self.basis)
        shared = dict(columns=columns, scaled=self.basis, coarse=coarse)
        for k, one in enumerate(each):
            # A ground takes a row out of A and gives all columns one more part: AᵀA changes
            # by three directions.
            own = through(self.factors(np.array([k]))[0], self.grounded[k])
            values, vectors = np.linalg.eigh(once - own)
            most = np.argsort(-np.abs(values))[:_CHANGED]
            less = basis.T @ (vectors * values)[:, most], vectors.T[most]
            less = tuple(jnp.asarray(part, dtype) for part in less)
            each[k] = one._replace(**shared, less=less)
        return each

    def _apart(self, values: A) -> A:
        """Picks every pixel that `reach` is apart, of values (..., pixels)."""
        (i, j), whole = self.reach, values.reshape(*values.shape[:-1], *self.shape)
        return whole[..., i // 2 :: i, j // 2 :: j].reshape(*values.shape[:-1], -1)

    def image(self, prepared: PreparedSource, voltages: Float[Array, "S M"]) -> Array:
        """Computes the slots' mean current image, A per pixel (or element of T)."""
        coefficients = matmul(voltages.ravel(), prepared.operators)
        return self.drive_sign * matmul(coefficients, self.basis)

    def smooth_image(
        self, prepared: PreparedSource, voltages: Float[Array, "S M"]
    ) -> Float[Array, "nx ny"]:
        """Computes the image that is drawn, A per pixel in the drive's direction."""
        coefficients = matmul(voltages.ravel(), prepared.imaging)
        return matmul(coefficients, self.smoothed).reshape(self.shape)

    def estimate(
        self, prepared: PreparedSource, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        coefficients = matmul(voltages.ravel(), prepared.operators)
        statistic = matmul(coefficients, prepared.scaled).reshape(self.shape)
        if prepared.less is not None:
            statistic *= prepared.sharp
        contacts = read_contacts(
            statistic, None, self.cell, count, lowest=prepared.lowest, reach=self.reach
        )
        # An image has not all of the current: a slot's offset, which tells how much it is,
        # is not used. As much as point sources there explain.
        columns = prepared.columns, prepared.less
        carried, left, rest = explained_by(self.shape, self.reach)(
            contacts.count > 1, contacts, coefficients, columns, self.cell
        )
        there = jnp.arange(count) < contacts.count.astype(int)
        carried = contacts._replace(current=self.drive_sign * carried)
        # Errors are in proportion to the highest peak: another contact stands out of them.
        hidden = matmul(rest, prepared.coarse)
        if prepared.less is not None:
            hidden *= self._apart(prepared.sharp.ravel())
        limit = jnp.maximum(_HIDES * _MODEL_ERROR * statistic.max(), prepared.lowest)
        missing = ((left > _UNEXPLAINED) | (hidden.max() > limit)) & (contacts.count > 0)

        residual, by_electrode = slots_left(prepared.misfits, voltages, prepared.used)
        image = self.smooth_image(prepared, voltages)
        return Estimate(
            strongest_first(carried, there),
            image * (self.drive_sign / self.cell.prod()),
            residual,
            flags=bits_of((missing, Flag.CONTACTS_UNEXPLAINED)),
            by_electrode=by_electrode,
        )


def _some(grounded: Bool[np.ndarray, "L M"]) -> Int[np.ndarray, " n"]:
    """Picks slots, spread evenly, that stand for all."""
    count, m = grounded.shape
    return np.arange(0, count, -(-count // _slots(m)))


def _slots(m: int) -> int:
    """Returns how many slots λ is chosen from: fewer of a large mat, as each takes long."""
    return max(1, _SLOTS * _LARGE // max(_LARGE, m))
