"""Films two fingers that part: when they are told as two, beside the bound.

    python tests/benchmarks/parting.py [--rigs 2] [--each 4] [--seed N]

Two discs move from 5 to 40 mm apart at 100 mm/s; every 10 ms has a scan of ten slots. Rigs
are drawn by default, as resistor networks (`bench.rigs`). A control film has one ellipse of
the pair's second moments, up to 20 mm. The bound is where the likeliest ellipse's voltages
are 4 σ of the rig's errors from the pair's: the best test then errs in 2.3 % either way.
The errors are linearised: the sheet's waves, electrodes off their places, gains and noise,
as they were drawn; of a calibration, the parts that it says are left. Cramér and Rao's
bound of the distance stands beside it. A row is told where two are found, each within half
their distance of its own. A film is told from the row on from which 19 of 20 rows are told,
the first one too. The default seed is for judging: no threshold was set on it. Writes
parting.json and parting.png.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.calibration import scene, ten_of  # noqa: E402
from benchmarks.parting_bound import Bound, bounds_of  # noqa: E402

RESULTS = HERE.parents[1] / "notebooks" / "results"
MM = np.arange(5, 40.5, 1.0)  # apart, a scan each
SPEED, TWIN = 100, 20  # mm/s; the control film ends there, mm
TOUCHES, KNOWN = 100, ("nominal", "calibrated")
STAYS = 0.95  # of the later rows


class Film(NamedTuple):
    """Two fingers: the middle, the direction, radii in m and conductances in S."""

    middle: np.ndarray
    turn: float
    radii: np.ndarray
    siemens: np.ndarray

    def pair(self, apart: float) -> list[Any]:
        from bench.rigs import Touch

        half = apart / 2 * np.array([np.cos(self.turn), np.sin(self.turn)])
        return [
            Touch(self.middle + s * half, (float(a), float(a)), 0.0, float(g))
            for s, a, g in zip((1, -1), self.radii, self.siemens)
        ]

    def twin(self, apart: float) -> list[Any]:
        """One even ellipse with the pair's middle and second moments."""
        from bench.rigs import Touch

        part, (one, other) = self.siemens / self.siemens.sum(), self.pair(apart)
        wide = (part * self.radii**2).sum()
        axes = float(np.sqrt(4 * part.prod() * apart**2 + wide)), float(np.sqrt(wide))
        middle = part[0] * one.xy + part[1] * other.xy
        return [Touch(middle, axes, self.turn, float(self.siemens.sum()))]


def film_of(sensor: Any, rng: np.random.Generator) -> Film:
    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    square = 1 / float(np.mean(np.asarray(sensor.sheet_resistance)))
    middle, turn = rng.uniform(1.25 * pitch, size - 1.25 * pitch), rng.uniform(0, np.pi)
    both, ratio = square * 10 ** rng.uniform(-1.5, 1.5), 10 ** rng.uniform(0, 0.5)
    parts = np.array([1, ratio]) / (1 + ratio)
    return Film(middle, float(turn), rng.uniform(0.1, 0.2, 2) * pitch, both * parts)


def drawn(number: int, options: argparse.Namespace) -> dict[str, Any]:
    """Voltages on one rig: of lone contacts that calibrate it, then of each film."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch, network_of

    rng = np.random.default_rng([options.seed, number])
    sensor = tx.Sensor.grid(dtype=np.float32)
    rig = draw_rig(sensor, rng)
    exact = network_of(rig)

    def read(touches: list[Any], ground: np.ndarray) -> np.ndarray:
        return rig.chain.read(scene(exact, touches, ground), rng).astype(np.float32)

    ten = ten_of(options.seed, number, TOUCHES + options.each)
    usual = [[draw_touch(sensor, "usual", rng)] for _ in range(TOUCHES)]
    rubs = np.array([read(touch, ground) for touch, ground in zip(usual, ten)])
    films = [film_of(sensor, rng) for _ in range(options.each)]
    filmed = list(zip(films, ten[TOUCHES:]))
    moving = [np.array([read(f.pair(mm / 1e3), g) for mm in MM]) for f, g in filmed]
    still = MM[MM <= TWIN] / 1e3
    alone = [np.array([read(f.twin(apart), g) for apart in still]) for f, g in filmed]
    known = tx.calibration.calibrate(sensor, rubs, ten[:TOUCHES])
    return {
        "films": films, "moving": moving, "alone": alone, "ten": ten[TOUCHES:],
        "known": dict(zip(KNOWN, (tx.Calibration(), known))),
    }  # fmt: skip


def told(counts: Any, xy: Any, film: Film, mm: np.ndarray) -> np.ndarray:
    """Which rows tell both fingers, each within half their distance of its own."""
    right = np.asarray(counts) == 2
    for k in np.flatnonzero(right):
        true, found = (
            np.array([t.xy for t in film.pair(mm[k] / 1e3)]),
            np.asarray(xy)[k, :2],
        )
        off = min(np.hypot(*(found[::way] - true).T).max() for way in (1, -1))
        right[k] = off < mm[k] / 2e3
    return right


def from_when(right: np.ndarray) -> int | None:
    """The row from which all but a twentieth of the rows are told; None: never."""
    later = np.cumsum(right[::-1])[::-1] / np.arange(len(right), 0, -1)
    good = np.flatnonzero(right & (later >= STAYS))
    return int(good[0]) if len(good) else None


def judged(rigs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each film and each way of telling, nominal and calibrated."""
    import tomojax as tx

    sensor, rows = tx.Sensor.grid(dtype=np.float32), []
    for name, number in ((name, k) for name in KNOWN for k in range(len(rigs))):
        rig = rigs[number]
        known = rig["known"][name]
        made = tx.method(sensor, "points", 32, known)
        batch = tx.Batch(made, made.choose_lambda([]), contacts=2, images=False)
        for k, film in enumerate(rig["films"]):
            films = rig["moving"][k], rig["alone"][k]
            ends = [_by_points(batch, known, scans, rig["ten"][k]) for scans in films]
            about = {"rig": number, "film": k, "known": name}
            for way, parting in ends[0].items():
                figures = _figures(film, parting, ends[1][way])
                rows.append(about | {"way": way} | figures)
    return rows


def _by_points(batch: Any, calibration: Any, scans: np.ndarray, ground: np.ndarray) -> dict:
    import tomojax as tx

    v = calibration.voltages(scans).astype(np.float32)
    found = batch(v, np.tile(ground, (len(v), 1)))
    tracks = tx.track(found, drive_voltage=4.5, sheet_resistance=1e4)
    doubt = found.flags & int(tx.Flag.COUNT_UNCERTAIN) > 0
    points = found.contact_count, found.contact_xy, doubt
    return {"points": points, "track": (tracks.contact_count, tracks.contact_xy, doubt)}


def _figures(film: Film, parting: Any, alone: Any) -> dict[str, Any]:
    right, split = told(parting[0], parting[1], film, MM), np.asarray(alone[0]) >= 2
    first = from_when(right)
    return {
        "told_mm": None if first is None else float(MM[first]),
        "split": _mean(split),
        "split_without_doubt": _mean(split & ~alone[2]),
        "right": right.astype(int).tolist(),
        "doubted": np.asarray(parting[2]).astype(int).tolist(),
    }


def beside(rows: list[dict[str, Any]], bounds: list[list[dict]]) -> list[dict[str, Any]]:
    """Adds the bounds, and how late a film is told after the bound."""
    found = []
    for row in rows:
        limits = bounds[row["rig"]][row["film"]]
        limit, at = limits[f"{row['known']} 10"], row["told_mm"]
        wide, mm = limits[f"{row['known']} 64"]["bound_mm"], limit["bound_mm"]
        late = None if at is None else 1e3 * (at - mm) / SPEED
        before = _mean(np.array(row["right"], bool)[MM < mm])
        more = {"bound_64_mm": wide, "late_ms": late, "told_before": before}
        found.append(row | limit | more)
    return found


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else 0.0


def summed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    table = []
    for key in dict.fromkeys((r["known"], r["way"]) for r in rows):
        some = [r for r in rows if (r["known"], r["way"]) == key]
        late = np.array([np.inf if r["late_ms"] is None else r["late_ms"] for r in some])
        at = [np.inf if r["told_mm"] is None else r["told_mm"] for r in some]
        up = {"method": "higher"}  # what is never told stays so
        table.append(
            dict(zip(("known", "way"), key))
            | {
                "films": len(some),
                "bound_mm": [
                    _quantile([r["bound_mm"] for r in some], q) for q in (0.5, 0.9)
                ],
                "bound_64_mm": _quantile([r["bound_64_mm"] for r in some], 0.5),
                "cramer_rao_mm": _quantile([r["cramer_rao_mm"] for r in some], 0.5),
                "told_mm": [_quantile(at, q, **up) for q in (0.5, 1)],
                "late_ms": [_quantile(late, q, **up) for q in (0.5, 1)],
                "within_50_ms": float((late <= 50).mean()),
                "never": int(np.isinf(late).sum()),
                "told_before": float(np.mean([r["told_before"] for r in some])),
                "split": float(np.mean([r["split"] for r in some])),
                "split_without_doubt": float(
                    np.mean([r["split_without_doubt"] for r in some])
                ),
            }
        )
    return table


def _quantile(values: Any, q: float, **more: Any) -> float | None:
    found = float(np.quantile(values, q, **more))
    return round(found, 2) if np.isfinite(found) else None


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draws each film: the bound, and where each way tells two from then on."""
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, ORANGE

    figure = Figure(figsize=(10, 3.6), layout="constrained")
    grid = figure.subplots(1, 2, sharey=True, sharex=True)
    looks = {"points": (BLUE, "o"), "track": (ORANGE, "^")}
    for axes, name in zip(grid, KNOWN):
        mine = [r for r in rows if r["known"] == name]
        for way, (colour, mark) in looks.items():
            some = [r for r in mine if r["way"] == way]
            at = [41 if r["told_mm"] is None else r["told_mm"] for r in some]
            x = [r["bound_mm"] for r in some]
            axes.plot(x, at, mark, color=colour, label=way, ms=6, alpha=0.75)
        ends = np.array([0, 40])
        axes.plot(ends, ends, color="0.4", lw=1, label="the bound")
        axes.plot(
            ends, ends + SPEED * 0.05, color="0.4", lw=1, ls="--", label="50 ms later"
        )
        axes.set(title=f"{name}, ten slots", xlabel="bound, mm apart", xlim=(0, 40))
        axes.set_ylim(0, 42)
    grid[0].set(ylabel="told as two from, mm apart (41: never)")
    grid[1].legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=2)
    parser.add_argument("--each", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1000151)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rigs = [drawn(k, options) for k in range(options.rigs)]
    write(beside(judged(rigs), bounded(rigs)), options)


def write(rows: list[dict[str, Any]], options: argparse.Namespace) -> None:
    from tomojax._environment import environment

    table = summed(rows)
    print("\n".join(json.dumps(row) for row in table))
    made = {name: getattr(options, name) for name in ("rigs", "each", "seed")}
    report = {"environment": environment(), "options": made, "rows": table, "films": rows}
    (options.out / "parting.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "parting.png")


def bounded(rigs: list[dict[str, Any]]) -> list[list[dict]]:
    import jax

    with jax.enable_x64(True):
        bound = Bound()
        return [
            [bounds_of(bound, f, t, rig["known"]) for f, t in zip(rig["films"], rig["ten"])]
            for rig in rigs
        ]


if __name__ == "__main__":
    main()
