"""`levels`: finds what conducts less and what conducts more than the rest of a body.

Conductance is σ₀·(1 + p)/(1 − p), p = β·(logistic(f₊) − logistic(f₋)). By Maxwell's formula
that is a body of which objects that conduct more take the part logistic(f₊), and objects
that conduct less the part logistic(f₋). f₊ and f₋ are Gaussian fields beforehand. Gauss
and Newton's steps with the exact model find the likeliest fields. A reference, read without
objects, takes the model's own errors away. Host code, float64.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from scipy.special import expit, ndtr

from tomojax._require import require
from tomojax.ert._electrode_model import ElectrodeModel, Transfer

# β = (κ − 1)/(κ + 1) of objects: 100 times as much as the rest, or a hundredth. Nothing
# beyond can be told from it.
_CONTRAST = 0.98

# The fields' deviation, and their mean: objects are few.
_WIDTH, _MEAN = 4.0, -8.0

# A field's correlation length, and a mesh's spacing, of a body's square root of area.
_LENGTH = 0.2

# Waves of each field.
_WAVES = 150

# A reading's error: parts of its change by objects, of what the model lacks of its
# reference, and of the largest reference. Errors of the model are like in many readings, so
# they count for more than their own sizes: the first and last came out at 0.1 and 0.0015.
# These three and the fields' mean were set on four tanks that were measured.
_CHANGED, _LACKING, _LEAST = 0.15, 0.3, 0.003

# How much the rest may have changed since the reference: the deviation of ln σ₀.
_DRIFT = 0.1

# Contact resistance is told from the reference within this range of what a square of the
# body as wide as an electrode resists, times its width.
_CONTACT = (1e-3, 10.0)

# Steps, the part of the cost that a step has to gain, and how far a field may move in one.
_STEPS, _ENOUGH, _FARTHEST = 40, 3e-3, 3.0

# Damping of the first step, of the prior, where it grows from when a step fails, and the
# times a step is tried.
_DAMPING, _MORE, _TRIES = 1e-2, 0.1, 8


class LevelsFound(NamedTuple):
    """What is found at each node of the model's mesh."""

    less: Float[np.ndarray, " N"]  # the probability that it conducts less than the rest
    more: Float[np.ndarray, " N"]  # and more
    conductance: Float[np.ndarray, " N"]  # of the rest's in the reference
    rest: float  # the rest's conductance, of that in the reference
    misfit: float  # of the readings' errors, rms

    def classes(self) -> Float[np.ndarray, " N"]:
        """Returns 1 where it likelier than not conducts less, 2 where more, 0 elsewhere."""
        either = np.where(self.less > self.more, 1.0, 2.0)
        return np.where(np.maximum(self.less, self.more) > 0.5, either, 0.0)


class _State(NamedTuple):
    """The model at some weights."""

    rest: Float[np.ndarray, " W"]  # misfit, of the errors
    volts: Float[np.ndarray, " W"]
    transfer: Transfer
    part: Float[np.ndarray, " T"]  # p
    cost: float


class Levels:
    """Finds two kinds of objects from one frame of readings, beside a reference.

    **Arguments:** `model`; `inject` (C, E), A into each electrode under each condition;
    `read` (C, R, E) or (R, E), weights of the electrodes' voltages in each reading;
    `reference` (C, R), V, read without objects. A reading that is NaN is left out.

    **Raises:** `ValueError` for shapes that do not fit together, or currents that do not
    add up to nothing.

    **Example:** a coin in a small tank, which conducts more.

    >>> import numpy as np
    >>> from tomojax.ert import disc_model, Levels
    >>> model = disc_model(radius=0.1, count=8, spacing=0.012)
    >>> pairs = np.eye(8) - np.roll(np.eye(8), 3, 0)
    >>> empty = np.ones(len(model.areas))
    >>> coin = np.hypot(*(model.nodes[model.triangles].mean(1) - [0.05, 0]).T) < 0.03
    >>> volts = [
    ...     pairs @ model.transfer(s, 1e-3).table @ pairs.T
    ...     for s in (empty, np.where(coin, 50, empty))
    ... ]
    >>> found = Levels(model, pairs, pairs, volts[0])(volts[1])
    >>> x, y = model.nodes[found.classes() == 2].mean(0)
    >>> bool(np.hypot(x - 0.05, y) < 0.005), bool(found.less.max() < 0.5)
    (True, True)
    """

    def __init__(
        self,
        model: ElectrodeModel,
        inject: Float[np.ndarray, "C E"],
        read: Float[np.ndarray, "... E"],
        reference: Float[np.ndarray, "C R"],
    ):
        inject, reference = np.asarray(inject, float), np.asarray(reference, float)
        electrodes = model.electrode_count
        shape = (*reference.shape, electrodes)
        count = (len(reference), electrodes)
        require(inject.shape == count, "inject", inject.shape, f"{count}")
        read = np.broadcast_to(np.asarray(read, float), shape)
        even = bool((abs(inject.sum(1)) <= 1e-6 * abs(inject).max()).all())
        require(even, "inject", "currents left over", "as much out as in")
        a, b = np.triu_indices(electrodes)
        readings = read[:, :, a] * inject[:, None, b] + read[:, :, b] * inject[:, None, a]
        self.model = model
        self.readings = (readings / np.where(a == b, 2, 1)).reshape(-1, len(a))
        self.reference = reference
        size = np.sqrt(model.areas.sum())
        self.waves = model.waves(_WAVES, _LENGTH * size)
        self._waves = self.waves[model.triangles].mean(1)  # of each triangle
        self._pairs = a, b
        self.contact, self.rest_conductance = self._of_reference()
        transfer = model.transfer(np.ones(len(model.areas)), self.contact)
        self.modelled = self._volts(transfer)

    def _of_reference(self) -> tuple[float, float]:
        """Fits the contact resistance, Ω·m at σ = 1, and then σ₀, S per square."""
        self.rest_conductance = 1.0
        known = np.isfinite(self.reference.ravel())
        require(known.any(), "reference", "no readings", "voltages")
        told = self.reference.ravel()[known]
        even = np.ones(len(self.model.areas))
        (a, b), under = self.model.sides.T, self.model.under
        long = np.linalg.norm(self.model.nodes[a] - self.model.nodes[b], axis=1)
        width = long.sum() / (under.max() + 1)

        def fit(exponent: float) -> tuple[float, float]:
            transfer = self.model.transfer(even, width * np.exp(exponent))
            volts = self._volts(transfer)[known]
            rest = (volts @ volts) / (volts @ told)
            return ((told - volts / rest) ** 2).sum(), rest

        found = minimize_scalar(
            lambda x: fit(x)[0], bounds=np.log(_CONTACT), method="bounded",
            options={"xatol": 0.1},
        )  # fmt: skip
        return float(width * np.exp(found.x)), float(fit(found.x)[1])

    def _volts(self, transfer: Transfer) -> Float[np.ndarray, " W"]:
        return self.readings @ transfer.table[self._pairs] / self.rest_conductance

    def __call__(self, volts: Float[np.ndarray, "C R"]) -> LevelsFound:
        """Finds the objects of one frame, V. Takes seconds to a minute."""
        shape = self.reference.shape
        require(np.shape(volts) == shape, "volts", np.shape(volts), f"{shape}")
        known = np.isfinite(volts) & np.isfinite(self.reference)
        require(known.any(), "volts", "no readings", "voltages")
        fit = _Fit(self, np.asarray(volts, float).ravel(), known.ravel())
        w, state, covariance = fit.likeliest()
        both = np.split(w[:-1], 2)
        field = [_MEAN + _WIDTH * self.waves @ each for each in both]
        count = len(both[0])
        probability = []
        for k, f in enumerate(field):
            part = slice(k * count, (k + 1) * count)
            spread = ((self.waves @ covariance[part, part]) * self.waves).sum(1)
            probability.append(ndtr(f / (_WIDTH * np.sqrt(spread))))
        part = _CONTRAST * (expit(field[1]) - expit(field[0]))
        rest, misfit = float(np.exp(w[-1])), float(np.sqrt((state.rest**2).mean()))
        return LevelsFound(*probability, rest * (1 + part) / (1 - part), rest, misfit)


class _Fit:
    """The likeliest weights of a frame: of the waves of f₋ and f₊, and ln σ₀'s change."""

    def __init__(self, levels: Levels, volts: np.ndarray, known: np.ndarray):
        self.levels, self.known = levels, known
        reference = levels.reference.ravel()
        self.told = volts[known]
        # What the model lacks without objects, it lacks with them.
        self.lacks = (reference - levels.modelled)[known]
        before = reference[known]
        changed = self.told - (self.told @ before) / (before @ before) * before
        parts = _CHANGED * changed, _LACKING * self.lacks, _LEAST * abs(before).max()
        self.error = np.sqrt(sum(part**2 for part in parts))
        scale = levels.rest_conductance * self.error[:, None]
        self.readings = levels.readings[known] / scale
        self.precision = np.ones(2 * levels.waves.shape[1] + 1)
        self.precision[-1] = _DRIFT**-2

    def _parts(self, w: np.ndarray) -> list[np.ndarray]:
        """Computes the parts of each triangle that conduct less, and more."""
        return [expit(_MEAN + _WIDTH * self.levels._waves @ x) for x in np.split(w[:-1], 2)]

    def _state(self, w: np.ndarray) -> _State:
        less, more = self._parts(w)
        part = _CONTRAST * (more - less)
        levels = self.levels
        transfer = levels.model.transfer((1 + part) / (1 - part), levels.contact)
        volts = (levels._volts(transfer)[self.known] + self.lacks) * np.exp(-w[-1])
        rest = (volts - self.told) / self.error
        return _State(rest, volts, transfer, part, rest @ rest + self.precision @ w**2)

    def _slopes(self, w: np.ndarray, state: _State) -> Float[np.ndarray, "W K"]:
        steep = 2 * _CONTRAST * _WIDTH / (1 - state.part) ** 2 * np.exp(-w[-1])
        slopes = self.levels.model.slopes(state.transfer.fields)
        columns = [
            slopes @ ((sign * steep * x * (1 - x))[:, None] * self.levels._waves)
            for sign, x in zip((-1, 1), self._parts(w))
        ]
        return np.column_stack(
            [self.readings @ np.hstack(columns), -state.volts / self.error]
        )

    def likeliest(self) -> tuple[np.ndarray, _State, np.ndarray]:
        """Finds the weights, the model there, and the weights' covariance."""
        w = np.zeros(len(self.precision))
        state, damping = self._state(w), _DAMPING
        for _ in range(_STEPS):
            slopes = self._slopes(w, state)
            curvature = slopes.T @ slopes
            uphill = slopes.T @ state.rest + self.precision * w
            before = state
            for _ in range(_TRIES):
                damped = curvature + np.diag(self.precision * (1 + damping))
                step = -np.linalg.solve(damped, uphill)
                moves = _WIDTH * self.levels._waves @ step[:-1].reshape(2, -1).T
                step *= min(1.0, _FARTHEST / np.abs(moves).max())
                there = self._state(w + step)
                if there.cost < state.cost:
                    w, state, damping = w + step, there, damping / 4
                    break
                damping = max(8 * damping, _MORE)
            if before.cost - state.cost < _ENOUGH * before.cost:
                break
        return w, state, np.linalg.inv(curvature + np.diag(self.precision))
