"""`levels`: finds what conducts less and what conducts more than the rest of a body.

Conductance is σ₀·(1 + p)/(1 − p), p = β·(logistic(f₊) − logistic(f₋)). By Maxwell's formula
that is a body of which objects that conduct more take the part logistic(f₊), and objects
that conduct less the part logistic(f₋). f₊ and f₋ are Gaussian fields beforehand. Gauss
and Newton's steps with the exact model find the likeliest fields. A reference, read without
objects, takes the model's own errors away. Host code, float64.
"""

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from scipy.special import expit, ndtr

from tomojax._require import require
from tomojax.ert.bodies._electrode_model import ElectrodeModel, Transfer

# β = (κ − 1)/(κ + 1) of objects that conduct 100 times as much as the rest, or a hundredth:
# no voltage tells metal or plastic from these.
_CONTRAST = 0.98

# The fields' deviation, and their mean: objects are few.
_WIDTH, _MEAN = 4.0, -10.0

# A field's correlation length, of the square root of the body's area.
_LENGTH = 0.15

# Waves of each field.
_WAVES = 150

# A reading's error: parts of its change by objects, of what the model lacks of its
# reference, and of the largest reference. Errors of the model are like in many readings, so
# they count for more than their own sizes: the first and last came out at 0.1 and 0.0015.
# These three, the fields' mean and their length were set on four measured tanks.
_CHANGED, _LACKING, _LEAST = 0.15, 0.3, 0.003

# How much the rest may have changed since the reference: the deviation of ln σ₀.
_DRIFT = 0.1

# Contact resistance is told from the reference within this range of what a square of the
# body as wide as an electrode resists, times its width.
_CONTACT = (1e-3, 10.0)

# Both fields where the fit begins: at their mean, no voltage would show them.
_START = -4.0

# Steps, the part of the cost that a step has to gain, and how far a field may move in one.
_STEPS, _ENOUGH, _FARTHEST = 40, 3e-3, 3.0

# Damping of the first step, of the prior, where it grows from when a step fails, and the
# times a step is tried.
_DAMPING, _MORE, _TRIES = 1e-2, 0.1, 8


class LevelsFound(NamedTuple):
    """What is found at each node of the model's mesh.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.ert import LevelsFound
    >>> less, more = np.array([0.9, 0.2, 0.0]), np.array([0.0, 0.1, 0.8])
    >>> LevelsFound(less, more, 1 + more - less, rest=1.0, misfit=1.0).classes().tolist()
    [1.0, 0.0, 2.0]
    """

    less: Float[np.ndarray, " N"]  # the probability that it conducts less than the rest
    more: Float[np.ndarray, " N"]  # and more
    conductance: Float[np.ndarray, " N"]  # of the rest's in the reference
    rest: float  # the rest's conductance, of that in the reference
    misfit: float  # rms, of the readings' errors

    def classes(self) -> Float[np.ndarray, " N"]:
        """Returns 1 where it likelier than not conducts less, 2 where more, 0 elsewhere."""
        either = np.where(self.less > self.more, 1.0, 2.0)
        return np.where(np.maximum(self.less, self.more) > 0.5, either, 0.0)


class Levels(eqx.Module):
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

    model: ElectrodeModel
    reference: Float[np.ndarray, "C R"]  # V
    contact: float  # contact resistance times the rest's conductance, m
    rest_conductance: float  # σ₀, S per square, in the reference
    readings: Float[np.ndarray, "W P"]  # of the pairs of `slopes`, at σ₀
    modelled: Float[np.ndarray, " W"]  # the reference by the model, V
    waves: Float[np.ndarray, "N K"]

    def __init__(
        self,
        model: ElectrodeModel,
        inject: Float[np.ndarray, "C E"],
        read: Float[np.ndarray, "... E"],
        reference: Float[np.ndarray, "C R"],
    ):
        inject, reference = np.asarray(inject, float), np.asarray(reference, float)
        shape = (*reference.shape, model.electrode_count)
        require(inject.shape == shape[::2], "inject", inject.shape, f"{shape[::2]}")
        even = bool((abs(inject.sum(1)) <= 1e-6 * abs(inject).max()).all())
        require(even, "inject", "currents left over", "as much out as in")
        require(np.isfinite(reference).any(), "reference", "no readings", "voltages")
        read = np.broadcast_to(np.asarray(read, float), shape)
        a, b = np.triu_indices(model.electrode_count)
        pairs = read[:, :, a] * inject[:, None, b] + read[:, :, b] * inject[:, None, a]
        pairs = (pairs / np.where(a == b, 2, 1)).reshape(-1, len(a))
        self.model = model
        self.reference = reference
        self.contact, modelled = _contact_of(model, pairs, reference.ravel())
        told = np.isfinite(reference.ravel())
        self.rest_conductance = _over(modelled[told], reference.ravel()[told])
        self.readings = pairs / self.rest_conductance
        self.modelled = modelled / self.rest_conductance
        self.waves = model.waves(_WAVES, _LENGTH * np.sqrt(model.areas.sum()))

    def __call__(self, volts: Float[np.ndarray, "C R"]) -> LevelsFound:
        """Finds the objects of one frame, V. Takes seconds to a minute."""
        shape = self.reference.shape
        require(np.shape(volts) == shape, "volts", np.shape(volts), f"{shape}")
        require(
            np.isfinite(volts + self.reference).any(), "volts", "no readings", "voltages"
        )
        w, state, covariance = _likeliest(_told(self, np.asarray(volts, float).ravel()))
        count = self.waves.shape[1]
        less, more = (_MEAN + _WIDTH * self.waves @ x for x in np.split(w[:-1], 2))
        both = covariance[:count, :count], covariance[count:-1, count:-1]
        spread = [_WIDTH * np.sqrt(((self.waves @ c) * self.waves).sum(1)) for c in both]
        part, rest = _CONTRAST * (expit(more) - expit(less)), np.exp(w[-1])
        return LevelsFound(
            less=ndtr(less / spread[0]),
            more=ndtr(more / spread[1]),
            conductance=rest * (1 + part) / (1 - part),
            rest=float(rest),
            misfit=float(np.sqrt((state.rest**2).mean())),
        )


def _over(modelled: np.ndarray, told: np.ndarray) -> float:
    """Tells by how much conductance is larger than the model's, from voltages."""
    return float((modelled @ modelled) / (modelled @ told))


def _contact_of(
    model: ElectrodeModel, pairs: np.ndarray, reference: np.ndarray
) -> tuple[float, np.ndarray]:
    """Fits contact resistance times conductance, m, to a reference; V of 1 S per square."""
    (a, b), told = model.sides.T, np.isfinite(reference)
    long = np.linalg.norm(model.nodes[a] - model.nodes[b], axis=1).sum()
    width = long / model.electrode_count
    even, upper = np.ones(len(model.areas)), np.triu_indices(model.electrode_count)

    def volts(exponent: float) -> np.ndarray:
        return pairs @ model.transfer(even, float(width * np.exp(exponent))).table[upper]

    def misfit(exponent: float) -> float:
        modelled = volts(exponent)[told]
        rest = reference[told] - modelled / _over(modelled, reference[told])
        return float(rest @ rest)

    found: Any = minimize_scalar(
        misfit, bounds=np.log(_CONTACT), method="bounded", options={"xatol": 0.1}
    )
    return float(width * np.exp(found.x)), volts(found.x)


class _Told(NamedTuple):
    """One frame's readings, and what the fit needs of the model."""

    model: ElectrodeModel
    contact: float
    waves: Float[np.ndarray, "T K"]  # in the middle of each triangle
    pairs: Float[np.ndarray, "W P"]
    volts: Float[np.ndarray, " W"]
    lacks: Float[np.ndarray, " W"]  # V that the model lacks, without objects and with them
    error: Float[np.ndarray, " W"]  # V
    precision: Float[np.ndarray, " n"]  # of the weights beforehand


class _State(NamedTuple):
    """The model at some weights."""

    rest: Float[np.ndarray, " W"]  # misfit, of the errors
    volts: Float[np.ndarray, " W"]
    transfer: Transfer
    part: Float[np.ndarray, " T"]  # p
    cost: float


def _told(levels: Levels, volts: np.ndarray) -> _Told:
    reference = levels.reference.ravel()
    known = np.isfinite(volts + reference)
    volts, reference = volts[known], reference[known]
    lacks = reference - levels.modelled[known]
    changed = volts - reference / _over(reference, volts)
    parts = _CHANGED * changed, _LACKING * lacks, _LEAST * abs(reference).max()
    waves = levels.waves[levels.model.triangles].mean(1)
    return _Told(
        model=levels.model,
        contact=levels.contact,
        waves=waves,
        pairs=levels.readings[known],
        volts=volts,
        lacks=lacks,
        error=np.sqrt(sum(part**2 for part in parts)),
        precision=np.r_[np.ones(2 * waves.shape[1]), _DRIFT**-2],
    )


def _parts(told: _Told, w: np.ndarray) -> list[np.ndarray]:
    """Computes the parts of each triangle that conduct less, and more."""
    return [expit(_MEAN + _WIDTH * told.waves @ x) for x in np.split(w[:-1], 2)]


def _state(told: _Told, w: np.ndarray) -> _State:
    less, more = _parts(told, w)
    part = _CONTRAST * (more - less)
    transfer = told.model.transfer((1 + part) / (1 - part), told.contact)
    upper = np.triu_indices(told.model.electrode_count)
    volts = (told.pairs @ transfer.table[upper] + told.lacks) * np.exp(-w[-1])
    rest = (volts - told.volts) / told.error
    return _State(rest, volts, transfer, part, rest @ rest + told.precision @ w**2)


def _slopes(told: _Told, w: np.ndarray, state: _State) -> Float[np.ndarray, "W n"]:
    steep = 2 * _CONTRAST * _WIDTH / (1 - state.part) ** 2 * np.exp(-w[-1])
    slopes = told.model.slopes(state.transfer.fields)
    columns = [
        slopes @ ((sign * steep * x * (1 - x))[:, None] * told.waves)
        for sign, x in zip((-1, 1), _parts(told, w))
    ]
    fields = told.pairs @ np.hstack(columns)
    return np.column_stack([fields, -state.volts]) / told.error[:, None]


def _likeliest(told: _Told) -> tuple[np.ndarray, _State, np.ndarray]:
    """Finds weights (of the waves of f₋ and f₊, and ln of the rest's change).

    Returns the model there, and the weights' covariance, too.
    """
    w, damping = np.zeros(len(told.precision)), _DAMPING
    # The first wave of each field is even: both begin where they can be seen.
    w[: len(w) - 1 : told.waves.shape[1]] = (_START - _MEAN) / _WIDTH / told.waves[0, 0]
    state = _state(told, w)
    for _ in range(_STEPS):
        slopes, before, whole = _slopes(told, w, state), state.cost, 1.0
        uphill = slopes.T @ state.rest + told.precision * w
        for _ in range(_TRIES):
            damped = slopes.T @ slopes + np.diag(told.precision * (1 + damping))
            step = -np.linalg.solve(damped, uphill)
            moves = _WIDTH * told.waves @ step[:-1].reshape(2, -1).T
            whole = _FARTHEST / np.abs(moves).max()
            step *= min(1.0, whole)
            there = _state(told, w + step)
            if there.cost < state.cost:
                w, state, damping = w + step, there, damping / 4
                break
            damping = max(8 * damping, _MORE)
        # A field that starts far from where it shows anything gains little at first.
        if before - state.cost < _ENOUGH * before and whole >= 1:
            break
    slopes = _slopes(told, w, state)
    return w, state, np.linalg.inv(slopes.T @ slopes + np.diag(told.precision))
