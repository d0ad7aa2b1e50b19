"""From which distance a test could tell two discs from any ellipse, on a rig with errors.

`parting.py` uses it. Voltages are the library's exact ones: two discs against the ellipse
that fits them best, in σ of what noise and the rig's errors make. Those are linearised.
"""

from typing import Any

import numpy as np

SLOTS, SURE = (10, 64), 4.0  # σ: the best test then errs in 2.3 % either way


class Bound:
    """Computes how well a test could tell two discs from an ellipse on a rig."""

    def __init__(self) -> None:
        import jax
        import jax.numpy as jnp

        import tomojax as tx

        every = np.arange(64)
        fine = tx.Sensor.grid(divisions=(64, 64), dtype=np.float64)
        coarse = tx.Sensor.grid(divisions=(32, 32), dtype=np.float64)

        def ellipse(p: Any) -> Any:  # x, y, ln a, ln b, angle, ln S
            shape = tx.Ellipse.of_total(p[:2], jnp.exp(p[2:4]), p[4], jnp.exp(p[5]))
            return tx.voltages(fine, shape, every)

        def discs(sensor: Any, p: Any) -> Any:  # x, y, ln radius, ln S, of each
            each = [tx.Disc.of_total(q[:2], jnp.exp(q[2]), jnp.exp(q[3])) for q in p]
            return tx.voltages(sensor, tx.Scene(*each), every)

        def of_rig(p: Any, xy: Any, waves: Any) -> Any:
            from dataclasses import replace

            sheet = 1e4 * jnp.ones(coarse.element_count) + 1e4 * waves
            return discs(replace(coarse, electrode_xy=xy, sheet_resistance=sheet), p)

        self.ellipse, self.by_ellipse = jax.jit(ellipse), jax.jit(jax.jacfwd(ellipse))
        self.pair = jax.jit(lambda p: discs(fine, p))
        self.by_pair = jax.jit(jax.jacfwd(lambda p: discs(fine, p)))
        xy = jnp.asarray(coarse.electrode_xy)
        still = jnp.zeros(coarse.element_count)
        moved = lambda p, d, w: jax.jvp(lambda *a: of_rig(p, *a), (xy, still), (d, w))  # noqa: E731
        self.moved = jax.jit(lambda p, d, w: moved(p, d, w)[1])
        self.off = 0.03 * float(coarse.electrode_diameter)
        self.waves = 0.02 * _waves(coarse.size, 32)

    def errors(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """Returns what each error of one σ makes of all voltages, (errors, 64, 64)."""
        none, still = np.zeros((64, 2)), np.zeros(self.waves.shape[1])
        unit = self.off * np.eye(128).reshape(-1, 64, 2)
        volts = np.asarray(self.pair(p))
        return {
            "sheet": np.array([self.moved(p, none, w) for w in self.waves]),
            "place": np.array([self.moved(p, d, still) for d in unit]),
            "gain": 5e-4 * np.eye(64)[:, None] * volts,
        }

    def whitener(self, errors: dict, ground: np.ndarray, known: Any, noise: float) -> Any:
        """Returns the product with Σ^(−1/2) of some grounds' voltages."""
        part = {"sheet": known.error, "place": known.own, "gain": known.own}
        all_ = np.concatenate([float(part[k]) * e[:, ground] for k, e in errors.items()])
        q, s, _ = np.linalg.svd(all_.reshape(len(all_), -1).T, full_matrices=False)
        less = noise / np.sqrt(s**2 + noise**2) - 1

        def whiten(v: np.ndarray) -> np.ndarray:  # (64, 64, …) to (voltages, …)
            flat = v[ground].reshape(q.shape[0], -1)
            return (flat + q @ (less[:, None] * (q.T @ flat))) / noise

        return whiten


def _waves(size: Any, divisions: int) -> np.ndarray:
    """Waves of each element of a Gaussian covariance a quarter long, rms 1 in all."""
    from tomojax.kernels.sheet import cell_centres, smooth_modes

    places = np.repeat(cell_centres((divisions, divisions)), 2, 0) * np.asarray(size)
    found, less = smooth_modes(places, size, 6)
    part = np.exp(-((np.pi / 4) ** 2) / less / 4)  # 1/less is i² + j²
    return np.asarray(found) * (part / np.sqrt((part**2).sum()))[:, None]


def bounds_of(
    bound: Bound, film: Any, ten: np.ndarray, known: dict[str, Any]
) -> dict[str, dict[str, float]]:
    """Returns the distance of 4 σ, and Cramér and Rao's σ of the distance at 15 mm, mm."""
    errors, noise = bound.errors(_discs(film, 0.015)), 4.5 * 6.7e-5 * 2**0.5
    found, guess = {}, {10: 10.0, 64: 6.0}
    for name, calibration in known.items():
        for slots in SLOTS:
            ground = ten if slots == 10 else np.arange(64)
            whiten = bound.whitener(errors, ground, calibration, noise)
            guess[slots], power = _parted(bound, film, whiten, guess[slots])
            found[f"{name} {slots}"] = {
                "bound_mm": guess[slots],
                "power": power,
                "cramer_rao_mm": _cramer_rao(bound, _discs(film, 0.015), whiten),
            }
    return found


def _discs(film: Any, apart: float) -> np.ndarray:
    each = film.pair(apart)
    return np.array([[*t.xy, np.log(t.half_axes[0]), np.log(t.conductance)] for t in each])


def _parted(bound: Bound, film: Any, whiten: Any, guess: float) -> tuple[float, float]:
    """Finds the distance of 4 σ, mm: σ is a power of the distance. Returns the power too.

    σ is computed twice, and the second time not far from 4.
    """
    first, start = _sigmas(bound, film, guess / 1e3, whiten, None)
    near = guess * np.clip((SURE / first) ** (1 / 3), 0.5, 2)
    near = near * 0.95 if abs(near / guess - 1) < 0.03 else near
    second, _ = _sigmas(bound, film, near / 1e3, whiten, start)
    power = float(np.clip(np.log(second / first) / np.log(near / guess), 1.5, 5))
    return float(near * (SURE / second) ** (1 / power)), power


def _sigmas(bound: Bound, film: Any, apart: float, whiten: Any, start: Any) -> Any:
    from scipy.optimize import least_squares

    target = whiten(np.asarray(bound.pair(_discs(film, apart))))[:, 0]
    (twin,) = film.twin(apart)
    axes = np.log(np.maximum(twin.half_axes, 2e-3))
    first = np.array([*twin.xy, *axes, twin.angle, np.log(twin.conductance)])
    first = first if start is None else np.append(start[:2], [*first[2:4], *start[4:]])
    lowest = np.full(6, -np.inf)
    lowest[2:4] = np.log(1.5e-3)  # narrower is no contact
    found = least_squares(
        lambda p: whiten(np.asarray(bound.ellipse(p)))[:, 0] - target,
        first,
        lambda p: whiten(np.asarray(bound.by_ellipse(p))),
        (lowest, np.inf),
        x_scale=np.array([1e-3, 1e-3, 0.3, 0.3, 0.3, 0.3]),
        max_nfev=8,
        ftol=2e-2,
    )
    return np.sqrt(2 * found.cost), found.x


def _cramer_rao(bound: Bound, p: np.ndarray, whiten: Any) -> float:
    """σ of the distance; sizes are known to a factor of 1.4 beforehand, as drawn."""
    slope = whiten(np.asarray(bound.by_pair(p)).reshape(64, 64, 8))
    prior = np.tile([0, 0, 1 / 0.35, 0], 2)
    covariance = np.linalg.inv(slope.T @ slope + np.diag(prior**2))
    along = (p[0, :2] - p[1, :2]) / np.hypot(*(p[0, :2] - p[1, :2]))
    by = np.concatenate([along, [0, 0], -along, [0, 0]])
    return float(1e3 * np.sqrt(by @ covariance @ by))
