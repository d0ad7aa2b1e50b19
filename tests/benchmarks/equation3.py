"""Compares `linear` with Eq. 3 by pyEIT and by NumPy, and finds what each change gains.

    python tests/benchmarks/equation3.py [--scenes 40] [--seed 1000050]

Scenes are those of `tomojax frontier`. Peers choose λ, reading and points in hindsight;
`linear` keeps its own. Each change of the plain form is tried alone. Times are of 256
frames in a call, one after the other: only their ratio counts. Writes equation3.json and
equation3.png.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE)]

import numpy as np  # noqa: E402

PATTERNS = ("corner", "corners", "edge", "all")
EQ3 = ("scikit-fem + NumPy", "pyEIT")
# The kinds of scene that have a bar to reach.
SHOWN = ("one", "two", "bar", "large")
PIXELS, BATCH, TABLE1 = 32, 256, 1.8e-3

Frames = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def changed(maps: np.ndarray, grounds: np.ndarray, change: str) -> Frames:
    """Makes Eq. 3 with one change, from voltages (n, S, M) to φ and what is read of it."""
    m, some = maps.shape[1], maps[grounds].astype(float)
    centres = np.broadcast_to(np.eye(m), (len(grounds), m, m)).copy()
    if change in ("level left out", "level and slots", "all but the lone place"):
        for centre, ground in zip(centres, grounds):
            used = np.arange(m) != ground
            centre[...] = np.diag(used * 1.0) - np.outer(used, used) / used.sum()
    if change == "rows by their lengths":
        length = np.linalg.norm(some, axis=2)
        centres /= (length + 1e-2 * length.max())[..., None]
    some = centres @ some
    each = change in ("slot by slot", "level and slots", "all but the lone place")
    parts = some if each else some.reshape(1, -1, some.shape[-1])
    operators, seen = [], 0
    for rows in parts:
        wide = len(rows) <= rows.shape[1]
        gram = rows @ rows.T if wide else rows.T @ rows
        damped = gram + TABLE1 * np.linalg.eigvalsh(gram)[-1] * np.eye(len(gram))
        operator = np.linalg.solve(damped, rows if wide else rows.T)
        operators.append(operator if wide else operator.T)
        seen = seen + (operators[-1] * rows).sum(0)
    whole = np.concatenate(operators) / len(parts)
    scaled = change in ("divided by resolution", "all but the lone place")
    scale = 1 / np.sqrt(seen) if scaled else np.ones_like(seen)

    def call(volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        used = np.einsum("smk,nsk->nsm", centres, volts)
        phi = used.reshape(len(volts), -1) @ whole
        return phi * scale, phi

    return call


CHANGES = ("plain", "read at the peak", "level left out", "slot by slot",
           "level and slots", "rows by their lengths", "divided by resolution",
           "all but the lone place")  # fmt: skip
AT_PEAK = ("read at the peak", "divided by resolution", "all but the lone place")


def rows_of_change(method, volts, grounds, size, change: str) -> Any:
    """Reads contacts of all frames, each under its own grounds, with this change."""
    from bench.frontier import peer_contacts

    maps = np.asarray(method.factors) @ np.asarray(method.basis)
    read, phi = np.zeros((2, len(volts), PIXELS**2))
    sets, member = np.unique(grounds, axis=0, return_inverse=True)
    for k, own in enumerate(sets):
        mine = member.ravel() == k
        read[mine], phi[mine] = changed(maps, own, change)(volts[mine])
    reading = "peak" if change in AT_PEAK else "half"
    return peer_contacts("image", reading, read, phi, size)


def figures(rows, trials, size) -> Iterator[dict[str, Any]]:
    from bench.frontier import KINDS, score

    for kind in KINDS:
        at = np.flatnonzero(trials.kind == kind)
        told = score(rows.take(at), trials.of(at), size)
        names = "with_ghosts_median_mm", "with_ghosts_p90_mm", "count_right", "doubted"
        yield {"scene": kind, **{name: told[name] for name in names}}


def compared(sensor, trials) -> Iterator[dict[str, Any]]:
    """Yields rows of the changes, of `linear`, and of the peers."""
    import jax
    import jax.numpy as jnp

    import tomojax as tx
    from bench.frontier import (
        contact_of,
        grounds_of,
        hindsight,
        peer_contacts,
        peer_images,
        peers_of,
        repeated,
    )
    from tomojax.methods import Part

    size = np.asarray(sensor.size, float)
    method = tx.method(sensor, "linear", PIXELS)
    lam = method.choose_lambda([])
    every = [[p for p in some if p.name in EQ3] for some in zip(*peers_of(sensor, PIXELS))]
    every = [list(some) for some in zip(*every)]
    for name in PATTERNS:
        print(name, file=sys.stderr, flush=True)
        grounds = grounds_of(sensor, name, trials.volts)
        volts = np.take_along_axis(trials.volts, grounds[..., None], 1).astype("f4")
        common = {"pattern": name, "slots": grounds.shape[1]}
        for change in CHANGES:
            rows = rows_of_change(method, volts, grounds, size, change)
            for row in figures(rows, trials, size):
                yield {**common, "method": change, "kind": "change", **row}
        rows = tx.Batch(method, lam, 3)(volts, grounds)
        frames, own = np.resize(volts, (BATCH, *volts.shape[1:])), grounds[0]
        ready = method.prepare(own, np.ones(volts.shape[1:], bool), lam)
        under = np.tile(own, (BATCH, 1))

        def ours(images=False, frames=frames, ready=ready, under=under) -> None:
            part = Part(jnp.asarray(frames), under)
            jax.block_until_ready(method.block(ready, part, 3, images))

        flat = volts.reshape(len(volts), -1)
        calls: dict[Any, Callable[[], Any]] = {
            ("linear", "contacts"): ours,
            ("linear", "image"): lambda ours=ours: ours(True),
        }
        found = {("linear", "contacts"): (rows, {}), ("linear", "image"): (rows, {})}
        for variants in every:
            if variants[0].name == "pyEIT" and (grounds != grounds[0]).any():
                continue
            best = hindsight(variants, flat, grounds, trials, size)
            for output, chosen in best.items():
                made = peer_images(chosen.peer, flat, grounds, chosen.lam)
                solve = chosen.peer.prepare(own, chosen.lam, "float32")
                call = contact_of(solve, chosen.reading, PIXELS, size)
                call = solve if output == "image" else call
                flat_frames = frames.reshape(BATCH, -1)
                key = variants[0].name, output
                calls[key] = lambda c=call, f=flat_frames: c(f)
                told = {"lam": chosen.lam, "reading": chosen.reading}
                found[key] = peer_contacts(output, chosen.reading, *made, size), told
        times: dict[Any, list] = {key: [] for key in calls}
        for _ in range(3):  # in turn, so that what else runs is shared
            for key, call in calls.items():
                times[key].append(np.median(repeated(call)[1]))
        for key, (rows, told) in found.items():
            us = 1e6 * float(np.min(times[key])) / BATCH
            kind = "ours" if key[0] == "linear" else "peer"
            for row in figures(rows, trials, size):
                yield {
                    **common, "method": key[0], "output": key[1], "kind": kind, **told,
                    "us": us, **row,
                }  # fmt: skip


def beside(rows: list[dict]) -> list[dict]:
    """Sets `linear` beside the best peer: each figure's, whichever peer has it."""
    told = []
    for pattern in PATTERNS:
        for scene in dict.fromkeys(row["scene"] for row in rows):
            some = [r for r in rows if (r["pattern"], r["scene"]) == (pattern, scene)]
            peers = [r for r in some if r["kind"] == "peer"]
            ours = next(r for r in some if r["kind"] == "ours")
            row = {"pattern": pattern, "slots": ours["slots"], "scene": scene}
            for name in ("with_ghosts_median_mm", "with_ghosts_p90_mm"):
                best = min(r[name] for r in peers if r[name] is not None)
                row |= {name: ours[name], f"peer_{name}": best}
            contacts = [r["us"] for r in peers if r["output"] == "contacts"]
            row |= {"us": ours["us"], "peer_us": min(contacts)}
            told.append(row)
    return told


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    words = {"one": "One contact", "two": "Two, 15 to 40 mm apart",
             "bar": "A bar of 75 mm", "large": "A disc of 50 to 80 mm"}  # fmt: skip
    figure = Figure(figsize=(13, 4.4), layout="constrained")
    figure.suptitle("Eq. 3: place error, median and 90 %")
    told, x = beside(rows), np.arange(len(PATTERNS))
    plainest = [r for r in rows if r["method"] == "plain"]
    for axes, scene in zip(figure.subplots(1, len(SHOWN), sharey=True), SHOWN):
        mine = [r for r in told if r["scene"] == scene]
        first = [r for r in plainest if r["scene"] == scene]
        median, p90 = "with_ghosts_median_mm", "with_ghosts_p90_mm"
        lines = {"the paper's plain form": (first, median, p90),
                 "the best of pyEIT and NumPy, in hindsight":
                     (mine, f"peer_{median}", f"peer_{p90}"),
                 "linear": (mine, median, p90)}  # fmt: skip
        for k, (label, (some, low, high)) in enumerate(lines.items()):
            at = x + 0.2 * (k - 1)
            middle, top = (np.array([r[n] for r in some], float) for n in (low, high))
            bars = np.stack([np.zeros_like(top), top - middle])
            look = style(k, linestyle="none", markersize=7)
            axes.errorbar(at, middle, bars, **look, capsize=3, label=label)
        slots = [f"{p}\n{r['slots']}" for p, r in zip(PATTERNS, mine)]
        axes.set_xticks(x, slots)
        axes.set(title=words[scene], xlabel="grounds, slots", yscale="log")
        axes.grid(alpha=0.3)
        plain(axes.yaxis)
    figure.axes[0].set_ylabel("mm")
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1_000_050)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    from benchmarks.physics import environment

    import tomojax as tx
    from bench.frontier import make_trials

    begin = time.perf_counter()
    sensor = tx.Sensor.grid(divisions=(64, 64), dtype=np.float32)
    rows = list(compared(sensor, make_trials(sensor, options.scenes, options.seed)))
    told = beside(rows)
    for row in told:
        print({k: round(v, 2) if isinstance(v, float) else v for k, v in row.items()})
    path = options.out / "equation3.json"
    content = {"environment": environment(), "scenes": options.scenes,
               "seed": options.seed, "seconds": time.perf_counter() - begin,
               "beside": told, "rows": rows}  # fmt: skip
    path.write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
