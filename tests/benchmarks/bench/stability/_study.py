"""`tomojax stability`: finds where each method fails, and what the method says then.

A sweep goes from harmless to hopeless (`_scenes`, `_faults`). A method's limit is the last
value up to which four scenes in five are right. Beyond the limit, a place that is far off
must have a flag.
"""

import json
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bench.frontier import (
    DOUBT,
    FAR,
    identity,
    place_error,
    rows_of_steps,
    same_run,
)
from bench.stability import _faults, _scenes
from bench.stability._numbers import gradient_rows, solver_rows
from bench.stability._scenes import Bench, NEAR, Sweep, SweptScenes
from bench.stability._starts import resistance_rows, start_rows, STARTS
from tomojax.methods import AbstractMethod, Batch, frames_of, method as make_method, Rows
from tomojax.sensor import Sensor
from tomojax.step import make_step, Step

SWEEPS = {
    name: sweep._replace(values=tuple(map(float, sweep.values)))
    for name, sweep in (_scenes.SWEEPS | _faults.SWEEPS).items()
}

# What takes part; slow ones see a few of the scenes.
METHODS = ("linear", "source", "points", "follow", "auto")
QUICK = ("linear", "source", "points", "follow")
_FEW = {"auto": 3}
SCENES, QUICK_SCENES = 10, 4

# Those that are run in float64 too.
_BOTH = ("linear", "source", "points")

# Contacts looked for; slots of a step before what it says counts; pixels along a side.
CONTACTS, _SLOTS, _PIXELS = 3, 60, 32

# Part of the scenes that is right where a method holds; of places that are far off, the
# part that is flagged where it may be trusted to flag.
HOLDS, FLAGGED = 0.8, 0.95

# mm: one and a half of the paper's pitches.
_BLURRED = 30.0


class Trial:
    """Methods made once for a bench, and applied to scenes."""

    def __init__(self, bench: Bench):
        self.bench = bench
        self._models: dict[tuple[str, Any], AbstractMethod] = {}

    def found(self, name: str, scenes: SweptScenes, dtype: Any = np.float32) -> Rows:
        """Returns rows of a method; `linear` has every ground, the others two.

        The rows are in float64 only if `dtype` is and `jax.enable_x64` enables float64.
        """
        if name == "follow":
            return self._followed(scenes)
        model, bench = self._model(name, scenes.told, dtype), self.bench
        count = len(scenes.volts)
        every = np.arange(len(bench.electrodes))
        grounds = np.tile(every if name == "linear" else bench.corners, (count, 1))
        volts = np.take_along_axis(scenes.volts, grounds[..., None], 1)
        volts = volts.astype(dtype)
        good = np.isfinite(volts)
        lam = model.choose_lambda(frames_of(volts, grounds, good, 8)) * scenes.lam
        return Batch(model, lam, CONTACTS)(volts, grounds, good)

    def _model(self, name: str, told: Sensor | None, dtype: Any) -> AbstractMethod:
        def made(sensor: Sensor) -> AbstractMethod:
            cast = jax.tree.map(lambda a: a.astype(dtype), sensor)
            return make_method(cast, name, _PIXELS)

        if told is not None:
            return made(told)
        if (name, dtype) not in self._models:
            self._models[name, dtype] = made(self.bench.sensor)
        return self._models[name, dtype]

    @cached_property
    def step(self) -> Step:
        return make_step(self.bench.sensor, contacts=CONTACTS)

    def _followed(self, scenes: SweptScenes) -> Rows:
        """Returns rows after so many slots, each grounded as the step asks."""
        outs = []
        for k, volts in enumerate(scenes.volts):
            state, ground, out = self.step.state, 0, None
            parts = [volts] if scenes.before is None else [scenes.before[k], volts]
            for part in parts:
                for _ in range(_SLOTS):
                    state, out = self.step(state, part[ground], ground)
                    ground = int(out.ground)
            outs.append(jax.tree.map(np.asarray, out))
        return rows_of_steps(outs)


def trial_row(
    trial: Trial, method: str, scenes: SweptScenes, both: bool = True
) -> dict[str, Any]:
    """Returns how right, how far off and how doubted a method is on scenes of one value.

    If `both`, methods that take part in float64 are run in float64, too.
    """
    some = scenes.first(_FEW.get(method))
    try:
        rows = trial.found(method, some)
    except ValueError as error:
        return {"scenes": len(some.volts), "raised": str(error)}
    places = [xy[np.isfinite(xy).all(1)] for xy in some.xy]
    errors = np.array([place_error(rows, k, xy, some.whole) for k, xy in enumerate(places)])
    doubted = (rows.flags & DOUBT) > 0
    pitch = trial.bench.pitch
    far = errors > FAR * pitch
    near = errors <= (NEAR * pitch if some.near is None else some.near)
    row = {
        "scenes": len(errors),
        "raised": None,
        "near": float(near.mean()),
        "far": int(far.sum()),
        "far_undoubted": int((far & ~doubted).sum()),
        "doubted": float(doubted.mean()),
        "near_doubted": int((near & doubted).sum()),
        "silent": int((_not_numbers(rows) & ~doubted).sum()),
    }
    for key, part in (("median", 0.5), ("p90", 0.9)):
        value = np.sort(errors)[int(np.ceil(part * len(errors))) - 1]
        row[f"place_{key}_mm"] = 1e3 * float(value) if np.isfinite(value) else None
    if method == "auto":
        row["rungs"] = np.bincount(rows.rung, minlength=4).tolist()
    if both and method in _BOTH:
        with jax.enable_x64(True):
            wide = trial.found(method, some, np.float64)
        row |= _beside_float64(rows, wide)
    return row


def _beside_float64(rows: Rows, wide: Rows) -> dict[str, Any]:
    """Returns how far apart places of float32 and float64 are, where neither is doubted."""
    sound = ((rows.flags | wide.flags) & DOUBT) == 0
    same = rows.contact_count == wide.contact_count
    away = np.hypot(*np.moveaxis(rows.contact_xy - wide.contact_xy, -1, 0))
    apart = np.nanmax(np.where(np.isfinite(away), away, 0), 1)[sound & same]
    return {
        "dtypes_apart_mm": 1e3 * float(apart.max()) if len(apart) else 0.0,
        "dtypes_other_count": int((sound & ~same).sum()),
    }


def _not_numbers(rows: Rows) -> np.ndarray:
    """Returns which rows have a value that is no number."""
    there = np.arange(rows.contact_xy.shape[1]) < rows.contact_count[:, None]
    places = np.isfinite(rows.contact_xy).all(2) & np.isfinite(rows.contact_current)
    bad = (there & ~places).any(1) | ~np.isfinite(rows.residual)
    if rows.image is not None:
        bad |= ~np.isfinite(rows.image).all((1, 2))
    return bad


def sweep_rows(trial: Trial, name: str, methods: tuple[str, ...]) -> list[dict[str, Any]]:
    """Returns a row for each value and method of one sweep."""
    sweep, rows = SWEEPS[name], []
    for value in sweep.values:
        scenes = sweep.make(trial.bench, value)
        for method in methods:
            if takes_part(sweep, method, scenes):
                told = {"sweep": name, "method": method, "value": value}
                rows.append(told | trial_row(trial, method, scenes))
    return rows


def takes_part(sweep: Sweep, method: str, scenes: SweptScenes) -> bool:
    """Tells whether a method takes part: a step has one sensor, and no scans."""
    if sweep.only and method not in sweep.only:
        return False
    return method != "follow" or (sweep.follows and scenes.told is None)


def right(row: dict[str, Any]) -> float:
    """Returns the part of the scenes of one value in which a method is right.

    An image of Eq. 3 with J(0) blurs a place, and shows an electrode near the place.
    `linear` is right where nine in ten are within one and a half pitches.
    """
    if row["raised"] is not None:
        return 0.0
    if row["method"] == "linear":
        ninth = row["place_p90_mm"]
        return float(ninth is not None and ninth <= _BLURRED)
    return float(row["near"])


def holds(row: dict[str, Any]) -> bool:
    """Tells whether enough scenes are right, rounding apart."""
    return right(row) >= HOLDS - 1e-9


def limits(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns the limit of each sweep and method, and what the user gets beyond it."""
    found = []
    for name, method in dict.fromkeys((r["sweep"], r["method"]) for r in rows):
        some = [r for r in rows if (r["sweep"], r["method"]) == (name, method)]
        held = [holds(r) for r in some]
        count = held.index(False) if False in held else len(held)
        beyond = some[count:]
        far, undoubted = (
            sum(r.get(key, 0) for r in some) for key in ("far", "far_undoubted")
        )
        found.append(
            {
                "sweep": name,
                "method": method,
                "limit": some[count - 1]["value"] if count else None,
                "last": some[-1]["value"],
                "beyond": _beyond(beyond, far, undoubted),
                "far": far,
                "far_undoubted": undoubted,
                "silent": sum(r.get("silent", 0) for r in some),
                # None: not run in float64.
                "dtypes_apart_mm": max(
                    (r["dtypes_apart_mm"] for r in some if "dtypes_apart_mm" in r),
                    default=None,
                ),
                "dtypes_other_count": sum(r.get("dtypes_other_count", 0) for r in some),
                "test": _test(name, method),
            }
        )
    return found


# Sweeps in which the slow ones are tested.
SLOW_TESTS = ("contacts", "conductance_low", "gain")


def _test(sweep: str, method: str) -> str | None:
    """Returns the test that fails when the limit moves in, or the flags beyond change."""
    if method in _FEW and sweep not in SLOW_TESTS:
        return None
    file = "slow" if method in _FEW else method
    return f"tests/stability/test_sweeps_{file}.py::test_{method}[{sweep}]"


def _beyond(rows: list[dict[str, Any]], far: int, undoubted: int) -> str:
    if not rows:
        return "holds"
    words = []
    if any(r["raised"] for r in rows):
        words.append("error")
    if any(np.argmax(r.get("rungs", [0])) == 3 for r in rows):
        words.append("fallback")
    if far:
        words.append("flag" if undoubted <= (1 - FLAGGED) * far else "unflagged")
    return ", ".join(words) or "worse"


def run(
    sensor: Sensor,
    folder: Path,
    quick: bool = False,
    only: tuple[str, ...] = (),
    scenes: int | None = None,
    seed: int = 0,
    progress: Callable[[str], Any] = lambda done: None,
) -> list[dict[str, Any]]:
    """Returns rows of all sweeps; sweeps that `folder` has already are not repeated."""
    count = scenes or (QUICK_SCENES if quick else SCENES)
    folder.mkdir(parents=True, exist_ok=True)
    told = {"scenes": count, "seed": seed, "quick": quick, "sensor": identity(sensor)}
    same_run(folder / "stability-run.json", told)
    trial = Trial(Bench(sensor, count, seed))
    rows: list[dict[str, Any]] = []
    methods = QUICK if quick else METHODS
    for name in only or SWEEPS:
        path = folder / f"stability-{name}.json"
        rows += _kept(path, lambda name=name: sweep_rows(trial, name, methods))
        progress(name)
    return rows


def numbers(folder: Path, quick: bool = False) -> dict[str, Any]:
    """Returns rows on solvers, gradients, ρ and optimisers' starts, kept in `folder`."""

    def made() -> dict[str, Any]:
        starts = STARTS[::3] if quick else STARTS
        points = (1000, 100) if quick else (10_000, 100)
        with jax.enable_x64(True):
            told = [resistance_rows(kind) for kind in (np.float32, np.float64)]
            return {
                "solvers": solver_rows(),
                "gradients": gradient_rows(*points),
                "resistances": sum(told, []),
                "starts": start_rows(starts),
            }

    return _kept(folder / "stability-numbers.json", made)


def _kept(path: Path, make: Callable[[], Any]) -> Any:
    """Reads the file, or makes it if there is none."""
    if path.exists():
        return json.loads(path.read_text())
    new = make()
    part = path.with_suffix(".part")
    part.write_text(json.dumps(new) + "\n")
    part.rename(path)
    return new
