"""Tries methods on skins of other outlines, with voltages of a model that is not ours.

    python tests/benchmarks/skins.py [--each 30] [--rigs 6] [--seed N] [--only SKIN ...]

Eight skins beside a rectangle (`bench.skins`): their voltages come of quadratic elements on
an unstructured mesh, on rigs with errors of the sheet, gains, places, paths and noise that
no method is told. Scenes have one, two or three contacts, a bar or a letter; each is read
from ten slots and from two. Places are judged in mean pitches, shapes by the overlap where
touch is likelier than not. The default seed is for judging: no threshold was set on it.
Making scenes needs the packages triangle and shapely. Writes skins.json and skins.png.
"""

import argparse
import json
import sys
import tempfile
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]
from bench.skins import KINDS  # noqa: E402

RESULTS = HERE.parents[1] / "notebooks" / "results"
METHODS = ("points", "source", "auto", "follow", "shape")


def sensor_of(d: dict) -> Any:
    """The sensor that methods are told: nominal values."""
    import jax.numpy as jnp
    from jax.tree_util import Partial

    import tomojax as tx
    from bench.skins import SURFACES

    told: dict[str, Any] = {"dtype": d.get("dtype", np.float32)}
    surface = SURFACES.get(d["surface"])
    if surface is not None:
        told["surface"] = Partial(lambda p: surface(p, jnp))
    if d["kind"] == "disc":
        return tx.Sensor.disc(d["size"][0], d["xy"], **told)
    if d["kind"] == "rectangle" and surface is None:
        return tx.Sensor(d["size"], d["xy"], **told)
    if d["kind"] == "rectangle":
        return tx.Sensor.cut(d["size"], None, d["xy"], **told)
    return tx.Sensor.polygon(d["outline"], d["xy"], d["holes"], **told)


def answers(sensor: Any, name: str, volts: np.ndarray, grounds: np.ndarray) -> dict:
    """A method's contacts, flags and, of `shape`, images of frames (n, S, M)."""
    import jax

    import tomojax as tx

    if name == "follow":
        step = tx.make_step(sensor, "follow", "all", contacts=4)
        replay = [step.replay(step.state, v, grounds)[1] for v in volts]
        last = [jax.tree.map(lambda a: np.asarray(a)[-1], out) for out in replay]
        return {
            "count": np.array([int(o.contacts.count) for o in last]),
            "xy": np.stack([o.contacts.xy for o in last]),
            "flags": np.array([int(o.flags) for o in last]),
        }
    shapes = name == "shape"
    pixels = (32,) if shapes else ()
    batch = tx.Batch(tx.method(sensor, name, *pixels), contacts=4, images=shapes)
    rows = batch(volts, np.tile(grounds, (len(volts), 1)))
    found = {"count": rows.contact_count, "xy": rows.contact_xy, "flags": rows.flags}
    return found | ({"touch": np.asarray(rows.touch)} if shapes else {})


def off(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Distances of true places to the found ones, in the best order."""
    orders = permutations(range(len(found)), len(true))
    each = [np.hypot(*(found[list(order)] - true).T) for order in orders]
    return min(each, key=np.sum)


def overlap(touch: np.ndarray, mask: np.ndarray) -> float:
    """The area that truth and what is likely touched share, of what either covers."""
    from scipy import ndimage

    at = np.indices(mask.shape) + 0.5
    grid = [(a / n * m) - 0.5 for a, n, m in zip(at, mask.shape, touch.shape)]
    # What is off the sheet is not a number.
    up = ndimage.map_coordinates(np.nan_to_num(touch), grid, order=1, mode="nearest")
    found = up > 0.5
    return float((found & mask).sum() / max(1, (found | mask).sum()))


def bounds(sensor: Any, places: np.ndarray, grounds: np.ndarray) -> float:
    """The least deviation of a place that noise alone leaves (Cramér and Rao), m: median.

    Of a contact of 6 mm and 20 µS at each place, of unknown radius and conductance.
    """
    import jax
    import jax.numpy as jnp

    import tomojax as tx

    def volts(told: Any) -> Any:
        disc = tx.Disc.of_total(told[:2], 6e-3 * told[2], 2e-5 * told[3])
        return tx.voltages(sensor, disc, grounds).ravel()

    found = []
    for place in places:
        told = jnp.asarray([*place, 1.0, 1.0], sensor.dtype)
        slopes = np.asarray(jax.jacfwd(volts)(told), float)
        spread = np.linalg.inv(slopes.T @ slopes) * tx.sensor.nominal_noise(sensor) ** 2
        found.append(np.sqrt(np.linalg.eigvalsh(spread[:2, :2])[-1]))
    return float(np.median(found))


def judged(found: dict, scenes: Any, kind: str) -> dict:
    """A row of figures of one kind of scene."""
    from bench.frontier import DOUBT

    some = np.flatnonzero(scenes["kinds"] == kind)
    doubt = (found["flags"][some] & int(DOUBT)) > 0
    row: dict[str, Any] = {"scenes": len(some), "flagged": int(doubt.sum())}
    if kind in ("bar", "letter"):
        shared = [overlap(found["touch"][i], scenes["masks"][i]) for i in some]
        return row | {
            "overlap": float(np.median(shared)),
            "overlap_p10": float(np.quantile(shared, 0.1)),
        }
    count, pitch = KINDS.index(kind) + 1, float(scenes["pitch"])
    right = found["count"][some] == count
    each = [
        off(found["xy"][i][:count], scenes["places"][i][:count]) / pitch
        for i in some[right]
    ]
    wrong = ~right
    wrong[right] = [bool((e > 0.5).any()) for e in each]
    far = np.concatenate(each) if each else np.array([np.nan])
    return row | {
        "right": int(right.sum()),
        "median": float(np.median(far)) if each else None,
        "p90": float(np.quantile(far, 0.9)) if each else None,
        "wrong_unflagged": int((wrong & ~doubt).sum()),
    }


def measured(options: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    from bench.skins import sheets

    rows = []
    for name, d in sheets().items():
        if options.only and name not in options.only:
            continue
        path = folder / f"{name}.npz"
        if not path.exists():
            from bench.skins.scenes import make_scenes

            make_scenes(name, d, folder, options.seed, options.each, options.rigs)
        scenes, sensor = dict(np.load(path)), sensor_of(d)
        lone = scenes["places"][scenes["kinds"] == "one", 0]
        for slots in (10, 2):
            told = bounds(sensor, lone, scenes[f"grounds{slots}"]) / scenes["pitch"]
            rows.append({"skin": name, "slots": slots, "bound": float(told)})
            print(json.dumps(rows[-1]), flush=True)
        for method in options.methods:
            kinds = KINDS[3:] if method == "shape" else KINDS[:3]
            some = np.isin(scenes["kinds"], kinds)
            part = scenes | {k: scenes[k][some] for k in ("kinds", "places", "masks")}
            for slots, cut in ((10, slice(0, 10)), (2, slice(10, 12))):
                volts = scenes["volts"][some][:, cut].astype(np.float32)
                found = answers(sensor, method, volts, scenes[f"grounds{slots}"])
                for kind in kinds:
                    row = {"skin": name, "method": method, "slots": slots, "scene": kind}
                    rows.append(row | judged(found, part, kind))
                    print(json.dumps(rows[-1]), flush=True)
        drop_programs()  # of all skins they are more than a process may map
    return rows


def drop_programs() -> None:
    """Drops what this process has compiled."""
    import jax

    from tomojax._programs import forget

    forget()
    jax.clear_caches()


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Median to 90 % of places, by skin and method, from ten slots and from two."""
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    rows = [row for row in rows if "method" in row]
    names = list(dict.fromkeys(row["skin"] for row in rows))
    figure = Figure(figsize=(12, 1.6 + 0.5 * len(names)), layout="constrained")
    figure.suptitle("One to three contacts and shapes on skins of other outlines")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, slots in zip(panels, (10, 2)):
        for k, method in enumerate(METHODS[:-1]):
            look = style(method, linestyle="none", markersize=5)
            for j, kind in enumerate(KINDS[:3]):
                mine = [
                    row for row in rows
                    if (row["method"], row["slots"], row["scene"]) == (method, slots, kind)
                ]  # fmt: skip
                at = [names.index(r["skin"]) + 0.2 * (k - 1.5) + 0.05 * j for r in mine]
                low, high = ([min(r[f] or 3, 3) for r in mine] for f in ("median", "p90"))
                axes.hlines(at, low, high, colors=look["color"])
                axes.plot(low, at, **look, label=method if not j else None)
        axes.set(xscale="log", xlabel="off, mean pitches", title=f"{slots} slots")
        axes.axvline(0.5, color="0.6", ls=":", lw=1)
        plain(axes.xaxis)
        axes.grid(axis="x", alpha=0.3)
    for j, kind in enumerate(("bar", "letter")):
        for slots in (10, 2):
            look = style(2 * j + (slots == 2), linestyle="none", markersize=5)
            mine = [r for r in rows if (r["slots"], r["scene"]) == (slots, kind)]
            at = [names.index(r["skin"]) + 0.2 * (j - 0.5) for r in mine]
            shared = [r["overlap"] for r in mine]
            panels[2].plot(shared, at, **look, label=f"{kind}, {slots} slots")
    panels[2].set(xlim=(0, 1), xlabel="overlap, median", title="`shape`")
    panels[2].legend(fontsize=8, loc="lower left")
    panels[0].set(yticks=range(len(names)), yticklabels=names)
    panels[0].invert_yaxis()
    told = panels[0].get_legend_handles_labels()
    figure.legend(*told, loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=30)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1000400)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument("--scenes", type=Path, help="a folder of scenes, kept")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        rows = measured(options, options.scenes or Path(made))
    told = {k: v for k, v in vars(options).items() if k not in ("out", "scenes")}
    text = json.dumps({"options": told, "rows": rows}, indent=1)
    (options.out / "skins.json").write_text(text + "\n")
    plot(rows, options.out / "skins.png")


if __name__ == "__main__":
    main()
