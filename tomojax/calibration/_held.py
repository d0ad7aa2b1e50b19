"""Makes a calibration a differentiable function of the voltages it comes from."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._require import require
from tomojax.calibration._calibrate import Calibrated
from tomojax.calibration._frames import Known, Near, near_of, points_of
from tomojax.calibration._unknowns import rig_slopes, RigSlopes, slopes_by_rig
from tomojax.kernels.contacts import Sheet, WhitenedFrame
from tomojax.methods import Points
from tomojax.sensor import Sensor

# Newton's steps end where none changes a value by more than this part of its deviation.
_CLOSE = 1e-9

# Newton's steps, at most.
_STEPS = 30


class HeldCalibration(eqx.Module):
    """The last pass of a calibration, with tables that change with the rig by slopes.

    θ(V) = argmin min_c Σ_k w_k Σ_s δ²·ln(1 + |r_ks|²/δ²) + priors. A frame's residual is
    r = C^(−1/2)[(V − offset)/gain − A(θ − θ*) − V(c)]. V(c) are its contact's voltages on
    the calibrated rig θ*; A are slopes of V by sheet, grounds and electrodes. A, the
    errors C and the weights w are held; contacts are at rest. `values` is differentiable
    in the voltages by the implicit function theorem, in float64. `values` solves for all
    values and contacts at once, which suits a few hundred frames.

    **Example:**

    >>> import jax
    >>> import numpy as np
    >>> import tomojax as tx
    >>> with jax.enable_x64(True):
    ...     sensor = tx.Sensor.grid(3, 3, divisions=(12, 12))
    ...     places = np.random.default_rng(0).uniform(0.008, 0.052, (24, 2))
    ...     discs, corners = [tx.Disc(xy, 0.004, 0.3) for xy in places], [0, 2, 6, 8]
    ...     volts = np.stack([tx.voltages(sensor, disc, corners) for disc in discs])
    ...     grounds = np.tile(corners, (24, 1))
    ...     known = tx.calibration.known_frames(sensor, volts, grounds, places)
    ...     found = tx.calibration.calibrated(sensor, known)
    ...     held = tx.calibration.HeldCalibration(sensor, found)
    >>> first = held.parts["gain"].start
    >>> by_voltages = jax.grad(lambda v: held.values(v)[first])  # call it where x64 is on
    """

    sheet: Sheet
    tolerance: Float[Array, ""]
    grounds: Int[Array, "n S"]
    places: Float[Array, "n 2"]
    spread: Float[Array, " n"]
    weight: Float[Array, " n"]
    scale: Float[Array, "n S M"]  # C^(−1/2)
    slopes: Float[Array, "n S M G"]  # A
    contacts: Float[Array, "n 5"]
    state: Float[Array, " P"]  # θ*
    start: Float[Array, " P"]
    prior: Float[Array, "P P"]
    root: Float[Array, "P P"]  # of the values' covariance
    parts: dict[str, slice] = eqx.field(static=True)

    def __init__(self, sensor: Sensor, found: Calibrated):
        """Fits the contacts. **Raises:** `ValueError` for a sensor in float32."""
        wide = sensor.dtype == np.float64
        require(wide, "sensor", sensor.dtype, "float64: derivatives are no better")
        unknowns, known = found.unknowns, found.frames
        points = points_of(sensor, found.told)
        volts = found.told.voltages(known.voltages.astype(float))
        require(bool(np.isfinite(volts).all()), "found", "channels of NaN", "volts in all")
        prepared = points.prepare(known.grounds[0], np.ones(volts.shape[1:], bool), 1.0)
        known = known._replace(voltages=volts).on_device(float)
        contacts, scale, slopes = _fits(points, rig_slopes(sensor), prepared, known)
        self.sheet, self.tolerance = points.sheet, prepared.tolerance
        self.grounds, self.places, self.spread = known.grounds, known.places, known.spread
        self.weight, self.contacts = known.weight, contacts
        self.scale, self.slopes = scale, slopes
        self.state, self.start = jnp.asarray(found.state), jnp.asarray(unknowns.start)
        self.prior = jnp.asarray(unknowns.prior)
        self.root = jnp.linalg.cholesky(jnp.asarray(found.covariance))
        self.parts = found.parts

    def cost(
        self, state: Float[Array, " P"], contacts: Float[Array, "n 5"], voltages: Array
    ) -> Float[Array, ""]:
        """Computes the cost of θ and the contacts, given voltages (n, S, M)."""
        m = voltages.shape[-1]
        gain, zero, moved = state[:m], state[m : 2 * m], (state - self.state)[2 * m :]
        tolerance = self.tolerance

        def one(v, grounds, place, spread, scale, slopes, contact) -> Array:
            v = (v - zero) / gain - jnp.matmul(slopes, moved, precision="highest")
            none = jnp.zeros((len(v), 0, m), v.dtype)
            frame = WhitenedFrame(grounds, v * scale, scale, none, none)
            found = Near(self.sheet, frame, tolerance, place, spread).explained(contact)
            misfit = (found.rest**2).sum(1) / tolerance
            return tolerance * jnp.log1p(misfit).sum() + (found.prior**2).sum()

        given = self.grounds, self.places, self.spread, self.scale, self.slopes
        each = jax.vmap(one)(voltages, *given, contacts)
        off = state - self.start
        known = jnp.matmul(self.prior, off, precision="highest")
        return self.weight @ each + off @ known

    @eqx.filter_jit
    def values(self, voltages: Float[Array, "n S M"]) -> Float[Array, " P"]:
        """Solves θ for voltages near those of the calibration, in the order of `parts`."""
        import lineax  # here: what calibrates need not wait for them
        import optimistix

        def slope(y: tuple[Array, Array], volts: Array) -> tuple[Array, Array]:
            cost = lambda y: self.cost(self._state(y[0]), self.contacts + y[1], volts)  # noqa: E731
            return jax.grad(cost)(y)

        # Of gradients, with outliers: neither positive nor well conditioned enough for CG.
        linear = lineax.LU()
        found = optimistix.root_find(
            slope,
            optimistix.Newton(rtol=_CLOSE, atol=_CLOSE, linear_solver=linear),
            (jnp.zeros_like(self.state), jnp.zeros_like(self.contacts)),
            args=jnp.asarray(voltages, self.state.dtype),
            max_steps=_STEPS,
            adjoint=optimistix.ImplicitAdjoint(linear_solver=linear),
        )
        return self._state(found.value[0])

    def _state(self, whitened: Float[Array, " P"]) -> Float[Array, " P"]:
        return self.state + jnp.matmul(self.root, whitened, precision="highest")


@eqx.filter_jit
def _fits(
    points: Points, slopes: RigSlopes, prepared: Any, frames: Known
) -> tuple[Array, Array, Array]:
    """Fits each frame: its contact, its errors' scale, and slopes by the rig's geometry."""

    def one(frame: Known) -> tuple[Array, Array, Array]:
        near, _ = near_of(points, prepared, frame)
        contact = near.fitted()
        fitted = near.explained(contact).fitted
        by_rig = slopes_by_rig(points.sheet, slopes, frame.grounds, fitted)
        return contact, near.frame.scale, by_rig[..., 2 * frame.voltages.shape[-1] :]

    return jax.vmap(one)(frames)
