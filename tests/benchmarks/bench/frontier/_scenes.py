"""Makes scenes with truth for `tomojax frontier`, and scores rows.

A resistor network makes the scenes' voltages.
"""

import hashlib
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from bench.network import Contact, Network
from tomojax.kernels import flags
from tomojax.methods import Rows
from tomojax.sensor import Sensor

KINDS = ("one", "two", "three", "bar", "large")

# Scenes of a rig: then another sheet, other electrodes, gains and zeros.
_SCENES_OF_A_RIG = 10

# Of a sensor, what its file tells.
_TOLD = (
    "size",
    "electrode_xy",
    "electrode_diameter",
    "sheet_resistance",
    "ground_resistance",
    "drive_voltage",
)

# Contacts at most; cells along a side of the true images.
_MOST, _FINE = 3, 64

# Lengths and conductances below are on the paper's sheet, m and Ω/sq; others in proportion.
_SIDE, _SQUARE = 0.16, 10e3

# A place that is further off is of something that is not there, pitches; of two contacts,
# both are found within this part of their distance.
FAR, APART = 1.0, 1 / 3

# Any of these says that a row is not to be trusted as it stands, or that nothing touches.
DOUBT = int(flags.DOUBT | flags.Flag.NO_CONTACT)


class Trials(NamedTuple):
    """n scenes as measured, and their true contacts."""

    kind: np.ndarray  # (n,) names
    volts: Float[np.ndarray, "n M M"]  # V, of every ground
    xy: Float[np.ndarray, "n C 2"]  # m; NaN beyond the contacts, strongest first
    conductance: Float[np.ndarray, "n C"]  # S
    image: Float[np.ndarray, "n nx ny"]  # S per cell

    def of(self, chosen: np.ndarray) -> "Trials":
        """Returns the chosen trials."""
        return Trials(*(values[chosen] for values in self))


def make_trials(
    sensor: Sensor,
    count: int,
    seed: int = 0,
    progress: Callable[[], Any] = lambda: None,
) -> Trials:
    """Makes `count` scenes of each kind: one, two or three contacts, a bar, a large one.

    Sizes and conductances vary by decades; every ten scenes are of another rig.
    """
    rng = np.random.default_rng(seed)
    made: list[tuple] = []
    rig = Network(sensor, rng)
    square = float(np.mean(np.asarray(sensor.sheet_resistance)))
    for kind in KINDS:
        for k in range(count):
            if k % _SCENES_OF_A_RIG == 0:
                rig = Network(sensor, rng)
            contacts = sorted(_contacts(kind, rig, square, rng), key=lambda c: -c[1])
            exact, truth = rig.scene(*contacts)
            xy, total = np.full((_MOST, 2), np.nan), np.full(_MOST, np.nan)
            for row, (place, conductance) in enumerate(truth):
                xy[row], total[row] = place, conductance
            made.append((kind, rig.measure(exact), xy, total, _image(rig, contacts)))
            progress()
    told: list = [np.array(values) for values in zip(*made)]
    return Trials(*told)


def _contacts(
    kind: str, rig: Network, square: float, rng: np.random.Generator
) -> list[Contact]:
    high = rig.cells.max(0)
    unit, siemens = high.min() / _SIDE, _SQUARE / square

    def somewhere(margin: float) -> np.ndarray:
        return rng.uniform(margin * unit, high - margin * unit)

    if kind == "one":
        radius = rng.uniform(0.003, 0.012)
        inside = rig.disc(somewhere(radius + 1e-3), radius * unit)
        return [(inside, siemens * 10 ** rng.uniform(-5.5, -2.5))]
    if kind == "bar":
        length, width = unit * rng.uniform([0.065, 0.008], [0.085, 0.012])
        inside = rig.bar(somewhere(0.055), length, width, rng.uniform(0, np.pi))
        return [(inside, siemens * 10 ** rng.uniform(-3.5, 0.5))]
    if kind == "large":
        inside = rig.disc(somewhere(0.05), unit * rng.uniform(0.025, 0.04))
        return [(inside, siemens * 10 ** rng.uniform(-3.5, -2))]
    if kind == "two":
        angle, apart = rng.uniform(0, np.pi), unit * rng.uniform(0.015, 0.04)
        half = apart / 2 * np.array([np.cos(angle), np.sin(angle)])
        middle = somewhere(0.035)
        places, largest = [middle + half, middle - half], 0.42 * apart / unit
    else:
        places, largest = _spread(lambda: somewhere(0.015), 0.03 * unit), 0.008
    radii = rng.uniform(0.003, min(0.008, largest), len(places))
    totals = 10 ** rng.uniform(-5, -3.3) * 10 ** -rng.uniform(0, 1, len(places))
    return [
        (rig.disc(p, r * unit), float(siemens * g))
        for p, r, g in zip(places, radii, totals)
    ]


def _spread(draw: Callable[[], np.ndarray], least: float) -> list[np.ndarray]:
    """Draws three places that are at least so far from each other."""
    places: list[np.ndarray] = []
    while len(places) < 3:
        new = draw()
        if all(np.hypot(*(new - place)) > least for place in places):
            places.append(new)
    return places


def _image(rig: Network, contacts: list[Contact]) -> Float[np.ndarray, "nx ny"]:
    """Returns conductance on coarse cells, S."""
    size = rig.cells.max(0) + rig.cells.min(0)
    index = np.minimum((rig.cells / size * _FINE).astype(int), _FINE - 1)
    image = np.zeros((_FINE, _FINE))
    for inside, total in contacts:
        np.add.at(image, tuple(index[inside].T), total / inside.sum())
    return image


def identity(sensor: Sensor) -> str:
    """Returns a hash of the sensor that a run's scenes are made for."""
    arrays = (np.asarray(getattr(sensor, name), np.float32) for name in _TOLD)
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()[:16]


def save_trials(path: Path, sensor: Sensor, trials: Trials) -> None:
    """Writes the trials, with the values from which a process makes the sensor anew."""
    told = {name: np.asarray(getattr(sensor, name)) for name in _TOLD}
    np.savez_compressed(path, allow_pickle=False, **told, **trials._asdict())


def load_trials(path: Path, dtype: str) -> tuple[Sensor, Trials]:
    """Reads what `save_trials` wrote; the sensor has 64 cells along its longer side."""
    with np.load(path) as file:
        told = {name: file[name] for name in _TOLD}
        trials = Trials(*(file[name] for name in Trials._fields))
    size = told["size"]
    cells = np.ceil(64 * size / size.max()).astype(int)
    divisions = int(cells[0]), int(cells[1])
    return Sensor(**told, divisions=divisions, dtype=dtype), trials


def score(rows: Rows, trials: Trials, size: np.ndarray) -> dict[str, Any]:
    """Scores trials of one kind: figures of places, counts, images, conductance and flags.

    A scene's place error is that of its worst contact, each to the nearest contact found. A
    bar or a large contact is compared with the mean of the contacts found, weighted by
    current. A scene in which nothing was found has an infinite error. `place_median_mm`,
    `place_p90_mm`, `far` and `far_undoubted` are of that error, and ignore ghosts.

    `with_ghosts_median_mm` and `with_ghosts_p90_mm` count ghosts, too: see `ghost_error`.
    The front and the comparison with the peers use these two. `ghosts` is the part of the
    scenes that have ghosts.
    """
    kind = str(trials.kind[0])
    there, whole = np.isfinite(trials.conductance), kind in ("bar", "large")
    places = [xy[some] for xy, some in zip(trials.xy, there)]
    errors = 1e3 * np.array(
        [place_error(rows, k, xy, whole) for k, xy in enumerate(places)]
    )
    ghosts = 1e3 * np.array(
        [ghost_error(rows, k, xy, whole) for k, xy in enumerate(places)]
    )
    worst = np.maximum(errors, ghosts)
    last = int(np.ceil(0.9 * len(errors))) - 1
    true_count = there.sum(1)
    doubted = (rows.flags & DOUBT) > 0
    far = errors > 1e3 * FAR * np.sqrt(np.prod(size) / trials.volts.shape[1])
    found = {
        "place_median_mm": _finite(np.median(errors)),
        "place_p90_mm": _finite(np.sort(errors)[last]),
        "with_ghosts_median_mm": _finite(np.median(worst)),
        "with_ghosts_p90_mm": _finite(np.sort(worst)[last]),
        "ghosts": float(np.mean(ghosts > 0)),
        "count_right": float(np.mean(rows.contact_count == true_count)),
        "doubted": float(doubted.mean()),
        "far_undoubted": int((far & ~doubted).sum()),
        "far": int(far.sum()),
        "scenes": len(errors),
    }
    if kind == "two":
        apart = [_told_apart(rows, k, trials) for k in range(len(errors))]
        found["told_apart"] = float(np.mean(apart))
    if kind == "one":
        off = np.abs(rows.contact_conductance[:, 0] / trials.conductance[:, 0] - 1)
        found["conductance_error"] = _finite(np.median(off))
    return found | _image_figures(kind, rows, trials, size)


def place_error(
    rows: Rows, k: int, places: Float[np.ndarray, "C 2"], whole: bool = False
) -> float:
    """Returns the largest distance of a contact at `places` to the nearest of row k, m.

    If `whole`, the contacts found are parts of one, and count by their currents.
    """
    count = int(rows.contact_count[k])
    if not count:
        return np.inf
    found = rows.contact_xy[k, :count]
    if whole:
        weight = np.maximum(np.nan_to_num(rows.contact_current[k, :count]), 1e-30)
        found = (weight[:, None] * found).sum(0, keepdims=True) / weight.sum()
    ways = np.hypot(*np.moveaxis(found[:, None] - places, -1, 0))
    return float(np.nan_to_num(ways, nan=np.inf).min(0).max())


def ghost_error(
    rows: Rows, k: int, places: Float[np.ndarray, "C 2"], whole: bool = False
) -> float:
    """Returns how far the farthest ghost of row k is from the nearest true contact, m.

    Each contact at `places` is matched with one found, so that the distances' sum is least.
    The contacts found that are left are ghosts. Without ghosts, and for `whole`, the error
    is 0.
    """
    count = int(rows.contact_count[k])
    if whole or count <= len(places):
        return 0.0
    found = np.nan_to_num(rows.contact_xy[k, :count], nan=np.inf)
    ways = np.minimum(np.hypot(*np.moveaxis(found[:, None] - places, -1, 0)), 1e3)
    taken, _ = linear_sum_assignment(ways)
    return float(np.delete(ways, taken, 0).min(1).max())


def _told_apart(rows: Rows, k: int, trials: Trials) -> bool:
    """Tells whether two contacts were found, each near one of the true ones."""
    if int(rows.contact_count[k]) != 2:
        return False
    places = trials.xy[k, :2]
    limit = APART * np.hypot(*(places[0] - places[1]))
    found = rows.contact_xy[k, :2]
    ways = (np.hypot(*(found[list(p)] - places).T).max() for p in permutations(range(2)))
    return bool(min(ways) < limit)


def _image_figures(kind: str, rows: Rows, trials: Trials, size: np.ndarray) -> dict:
    """Returns medians: width at half the maximum (single contacts), and image error."""
    if rows.image is None:
        return {}
    images = np.nan_to_num(rows.image.astype(float))
    n, (nx, ny) = len(images), images.shape[1:]
    truth = trials.image
    if _FINE % nx == 0 and _FINE % ny == 0:
        truth = truth.reshape(n, nx, _FINE // nx, ny, _FINE // ny).sum((2, 4))
    elif (nx, ny) != truth.shape[1:]:
        across = [_overlaps(_FINE, m) for m in (nx, ny)]
        truth = np.einsum("nxy,xi,yj->nij", truth, *across, optimize=True)
    dot = (images * truth).sum((1, 2))
    norms = (images**2).sum((1, 2)) * (truth**2).sum((1, 2)) + 1e-300
    error = np.sqrt(np.maximum(1 - np.where(dot > 0, dot**2 / norms, 0), 0))
    figures = {"image_error": float(np.median(error))}
    if kind == "one":
        above = images >= images.max((1, 2), keepdims=True) / 2
        area = above.mean((1, 2)) * float(np.prod(size))
        figures["width_mm"] = float(np.median(2e3 * np.sqrt(area / np.pi)))
    return figures


def _overlaps(fine: int, coarse: int) -> Float[np.ndarray, "fine coarse"]:
    """Returns the part of each of `fine` cells that lies in each of `coarse` cells."""
    low, high = np.arange(fine) / fine, (np.arange(fine) + 1) / fine
    start, end = np.arange(coarse) / coarse, (np.arange(coarse) + 1) / coarse
    shared = np.minimum(high[:, None], end) - np.maximum(low[:, None], start)
    return np.maximum(shared, 0) * fine


def _finite(value: Any) -> float | None:
    """Turns infinity and NaN into None, since JSON has neither."""
    return float(value) if np.isfinite(value) else None
