"""Places one and two presses on simulated skins, and draws letters; pyEIT beside.

    python tests/benchmarks/simulated_skins.py [--only SKIN ...] [--voltages FOLDER]

`bench.cem.Skin` makes the voltages: quadratic elements of scikit-fem, complete electrode
model. Skins: 16 electrodes on the rim of a disc of 100 mm; these and 8 inside; 8 × 8 in a
square of 160 mm. A press halves the conductance in a disc of 4 mm radius, more or less.
Noise is 0.1 % of the root mean square of all readings' changes, drawn anew by each seed.
Voltages take a quarter of an hour; `--voltages` keeps them. Writes simulated_skins.json and
.png to notebooks/results; rows of skins that `--only` leaves out stay.
"""

import argparse
import itertools
import json
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

RESULTS = HERE.parents[1] / "notebooks" / "results"
SHEET = 1e-2  # S per square
RADIUS = 4e-3  # of a press, m
SHUNT = 0.3  # told from the electrodes' contact: see `Sensor`
NOISE = 1e-3  # of the changes' root mean square
APART = (8, 12, 16, 20, 30, 40)  # mm, middle to middle: 8 touch
LONE, EACH = 40, 12  # frames of lone presses, and of pairs at each distance
LETTERS = "TLOH"


def ring(count: int, radius: float) -> np.ndarray:
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    return radius * np.stack([np.cos(turn), np.sin(turn)], 1)


def square() -> np.ndarray:
    line = 0.01 + 0.02 * np.arange(8)
    return np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2)


# Electrodes on the rim and inside; sides of a skin, m; skipped electrodes.
SKINS = {
    "rim": {"across": 0.1, "rim": 16, "skipped": 7},
    "inside": {"across": 0.1, "rim": 16, "inner": ring(8, 0.025), "skipped": 11},
    "grid": {"across": 0.16, "inner": square(), "round": False, "skipped": 31},
}


def pairs_of(name: str):
    from tomojax import ert

    told = SKINS[name]
    count = told.get("rim", 0) + len(told.get("inner", ()))
    return ert.Pairs.skip(count, told["skipped"])


def drawn_places(name: str, rng) -> list[np.ndarray]:
    """Places of presses, m, of each frame: 15 mm off the edge and more."""
    across = SKINS[name]["across"]

    def frame(away: float) -> np.ndarray:
        while True:
            start, turn = across * rng.uniform(-0.5, 0.5, 2), rng.uniform(0, 2 * np.pi)
            both = start + away * np.array([[0, 0], [np.cos(turn), np.sin(turn)]])
            far = np.hypot(*both.T) if name != "grid" else abs(both).max(1)
            if (far < across / 2 - 0.015).all():
                return both[: 2 if away else 1]

    frames = [frame(0.0) for _ in range(LONE)]
    frames += [frame(1e-3 * away) for away in APART for _ in range(EACH)]
    middle = across / 2 if name == "grid" else 0.0
    return [frame + middle for frame in frames]


def letter(name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Tells which places, of the letter's half height, are in its strokes."""
    wide = 0.28
    up, down = abs(y) < 1, abs(x) < 0.8
    left, right, top, bottom = x < -0.8 + wide, x > 0.8 - wide, y > 1 - wide, y < -1 + wide
    middle = abs(x) < wide / 2
    far = np.hypot(x, y)
    return {
        "T": up & down & (top | middle),
        "L": up & down & (left | bottom),
        "O": (far < 1) & (far > 1 - 1.2 * wide),
        "H": up & down & (left | right | (abs(y) < wide / 2)),
    }[name]


def made(name: str, folder: Path | None) -> dict:
    """Voltages of all scenes, V per A, and of none."""
    from bench.cem import disc, Skin

    path = folder and folder / f"{name}.npz"
    if path and path.is_file():
        return dict(np.load(path))
    told = {k: v for k, v in SKINS[name].items() if k != "skipped"}
    skin, pairs, rng = Skin(**told), pairs_of(name), np.random.default_rng(0)
    places = drawn_places(name, rng)
    depth = rng.uniform(0.3, 0.7, (len(places), 2))

    def volts(part) -> np.ndarray:
        return skin.voltages(pairs, lambda x: SHEET * part(x))

    def pressed(places, depth):
        return lambda x: np.prod(
            [1 - d * disc(x, p, RADIUS, skin.cell) for p, d in zip(places, depth)], 0
        )

    middle, high = letter_place(name)

    def drawn_as(which: str):
        return lambda x: (
            1 - 0.5 * letter(which, (x[0] - middle) / high, (x[1] - middle) / high)
        )

    empty = volts(lambda x: 1 + 0 * x[0])
    found = {
        "empty": empty,
        "places": np.stack([np.resize(p, (2, 2)) for p in places]),
        "count": np.array([len(p) for p in places]),
        "volts": np.stack([volts(pressed(*one)) for one in zip(places, depth)]) - empty,
        "letters": np.stack([volts(drawn_as(c)) for c in LETTERS]) - empty,
        "xy": skin.xy,
    }  # fmt: skip
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **found)
    return found


def recording_of(name: str, xy: np.ndarray, volts: np.ndarray):
    """The frames as a recording, and the sheet that stands for its nominal one."""
    import tomojax as tx

    told = SKINS[name]
    if name == "grid":
        where = {"size": (told["across"],) * 2}
    else:
        where = {"outline": tx.recordings.Outline("disc", told["across"])}
    wide = 0.0098 if name == "rim" else 0.005
    recording = tx.ert.PairRecording(volts, pairs_of(name), xy, wide, **where)
    return recording


def levels_of(scenes: dict):
    """`Levels` of the rim's skin: it tells the contacts' resistance from no press."""
    from tomojax.ert import disc_model, Levels

    pairs, each = pairs_of("rim"), np.eye(16)
    inject = each[pairs.inject[:, 0]] - each[pairs.inject[:, 1]]
    read = each[pairs.read[..., 0]] - each[pairs.read[..., 1]]
    return Levels(disc_model(0.05, 16, 0.0025), inject, read, scenes["empty"])


def judged(places: list[np.ndarray], scenes: dict) -> dict:
    """Errors and counts of all lone presses, and of pairs by distance.

    Pairs are told apart where two are found, each within half their distance of its own.
    """
    truth, count = scenes["places"], scenes["count"]
    group = np.r_[np.zeros(LONE, int), np.repeat(APART, EACH)]
    group = np.tile(group, len(places) // len(group))
    times = len(group) // len(count)
    truth, count = np.tile(truth, (times, 1, 1)), np.tile(count, times)
    right = np.array([len(p) == c for p, c in zip(places, count)])
    lone = [
        1e3 * np.linalg.norm(p[0] - t[0]) if len(p) else np.inf
        for p, t in zip(places, truth)
    ]
    lone = np.array(lone)[group == 0]
    row = {
        "lone_median_mm": float(np.median(lone)),
        "lone_p90_mm": float(np.quantile(lone, 0.9)),
        "lone_counted": float(right[group == 0].mean()),
    }
    for away in APART:
        some = [k for k in np.flatnonzero(group == away) if right[k]]
        both = [np.linalg.norm(places[k][:, None] - truth[k], axis=2) for k in some]
        worst = [min(max(d[0, 0], d[1, 1]), max(d[0, 1], d[1, 0])) for d in both]
        row[f"two_{away}_counted"] = float(right[group == away].mean())
        apart = sum(2e3 * one < away for one in worst)
        row[f"two_{away}_apart"] = apart / int((group == away).sum())
        row[f"two_{away}_median_mm"] = 1e3 * float(np.median(worst)) if worst else None
    return row


def ours(name: str, scenes: dict, frames: np.ndarray, noise: float) -> list[dict]:
    """Rows of `changes`, with the noise told and learned."""
    from tomojax import ert

    rows, recording = [], recording_of(name, scenes["xy"], frames)
    given = {"radius": RADIUS}
    sheets = {"nominal": given}
    if name != "rim":  # electrodes inside conduct a little along the sheet
        sensor = replace(recording.sensor(), electrode_shunt=np.float32(SHUNT))
        sheets[f"shunt {SHUNT}"] = given | {"sheet": sensor}
    for (sheet, given), (how, deviation) in itertools.product(
        sheets.items(), (("noise told", noise), ("noise learned", None))
    ):
        if name != "grid" or deviation:  # its 3840 readings ask for more frames
            found = ert.changes(recording, 2, deviation, **given)
            there = np.isfinite(found.strength)
            places = [xy[one] for xy, one in zip(found.xy, there)]
            method = {"skin": name, "method": f"changes, {sheet}, {how}"}
            rows.append(method | judged(places, scenes))
    return rows


def bound(name: str, scenes: dict, noise: float) -> dict:
    """What noise alone allows: the median deviation of a place of two, by distance, mm.

    Cramér and Rao's bound for two places and two strengths, slopes by differences.
    """
    from tomojax import ert

    recording = recording_of(name, scenes["xy"], scenes["volts"][:1])
    sensor, step = recording.sensor(float), 2e-4
    row = {"skin": name, "method": "bound"}
    for k, away in enumerate(APART):
        pick = LONE + EACH * k + np.arange(EACH)
        at = scenes["places"][pick] - recording.origin
        moves = step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        grid = (at[:, :, None] + moves).reshape(-1, 2)
        s = np.asarray(ert.sensitivities(sensor, recording.pairs, grid))
        s = s.reshape(len(pick), 2, 5, -1)
        slopes = np.stack([s[:, :, 1] - s[:, :, 2], s[:, :, 3] - s[:, :, 4]], 2) / (
            2 * step
        )
        wide = []
        for frame, slope, column in zip(scenes["volts"][pick], slopes, s[:, :, 0]):
            strength = np.linalg.lstsq(column.T, frame.ravel(), rcond=None)[0]
            slope = slope * strength[:, None, None]
            long = np.concatenate([slope.reshape(4, -1), column * abs(strength[0]) / 0.01])
            moments = noise**2 * np.linalg.inv(long @ long.T)
            wide.append(np.sqrt(np.trace(moments[:4, :4]) / 2))
        row[f"two_{away}_median_mm"] = 1e3 * float(np.median(wide))
    return row


class Raster:
    """Pixels of a skin, and images brought onto them."""

    def __init__(self, name: str):
        self.across, low = SKINS[name]["across"], 0.0 if name == "grid" else -0.05
        self.line = low + self.across * (np.arange(40) + 0.5) / 40
        self.x, self.y = np.meshgrid(self.line, self.line, indexing="ij")
        self.on = np.hypot(self.x, self.y) < 0.05 if name != "grid" else self.x > 0

    def of(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        found = LinearNDInterpolator(points, values)(self.x, self.y)
        near = NearestNDInterpolator(points, values)(self.x, self.y)
        return np.moveaxis(np.where(np.isfinite(found), found, near), -1, 0) * self.on

    def places(self, image: np.ndarray, share: float, blur: float) -> np.ndarray:
        """Weighted middles of regions above a share of the highest pixel."""
        from scipy.ndimage import gaussian_filter, label

        image = gaussian_filter(image, blur) if blur else image
        weight = np.maximum(image - share * image.max(), 0)
        parts, count = label(weight > 0)
        if not count:
            return np.empty((0, 2))
        heavy = np.bincount(parts.ravel(), weight.ravel())[1:]
        at = [
            np.bincount(parts.ravel(), (weight * v).ravel())[1:] / heavy
            for v in (self.x, self.y)
        ]
        order = np.argsort(-heavy)
        return np.stack(at, 1)[order[heavy[order] > 0.1 * heavy.max()]]


def pyeit_body(name: str, xy: np.ndarray):
    """pyEIT's mesh, electrodes at nodes, in m."""
    import pyeit.mesh as mesh
    import skfem
    from pyeit.mesh import PyEITMesh

    if name == "grid":
        line = np.linspace(0, SKINS[name]["across"], 33)
        made = skfem.MeshTri.init_tensor(line, line)
        nodes, elements = made.p.T, made.t.T
        one, other = (np.diff(nodes[elements[:, [0, k]]], axis=1)[:, 0] for k in (1, 2))
        back = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
        elements = np.where(back[:, None], elements[:, ::-1], elements)  # anticlockwise
    else:
        made = mesh.create(len(xy), h0=0.06, p_fix=xy / 0.05)
        nodes, elements = 0.05 * made.node[:, :2], made.element
    at = np.linalg.norm(nodes[:, None] - xy, axis=2).argmin(0)
    return PyEITMesh(node=nodes, element=elements, perm=1.0, el_pos=at)


def pyeit(name: str, scenes: dict, frames: np.ndarray, letters: np.ndarray) -> list[dict]:
    """pyEIT's row: each figure is the best of methods, settings and readings of images."""
    import pyeit.eit.bp as bp
    import pyeit.eit.greit as greit
    import pyeit.eit.jac as jac
    from pyeit.eit.protocol import PyEITProtocol

    pairs, body, raster = pairs_of(name), pyeit_body(name, scenes["xy"]), Raster(name)
    told = PyEITProtocol(pairs.inject, pairs.read, np.ones(pairs.read[..., 0].size, bool))
    empty = scenes["empty"].ravel()
    middle = body.node[body.element].mean(1)[:, :2]
    truth, best, marks = letter_images(name), {}, []
    settings = [
        (jac.JAC, {"p": 0.5, "lamb": k, "method": "kotre"}) for k in (1e-3, 1e-2, 0.1)
    ]
    settings += [(greit.GREIT, {"p": 0.5, "lamb": k, "n": 32}) for k in (1e-2, 0.1)]
    settings += [(bp.BP, {"weight": "none"})]
    for kind, setting in settings:
        eit = kind(body, told)
        eit.setup(**setting)
        every = np.concatenate([frames, letters]).reshape(-1, len(empty))
        images = np.stack([np.real(eit.solve(empty + one, empty)) for one in every])
        if kind is greit.GREIT:
            points = np.stack([eit.xg, eit.yg], -1).reshape(-1, 2)
            images = images.reshape(len(images), -1)
        else:
            points = middle if images.shape[1] == len(middle) else body.node[:, :2]
        images = raster.of(points, np.nan_to_num(images).T)
        for turned in (images, -images):
            drawn = turned[len(frames) :]
            marks.append([likeness(raster, one, t) for one, t in zip(drawn, truth)])
            for share, blur in itertools.product((0.3, 0.5, 0.7, 0.85), (0, 1.5)):
                places = [raster.places(one, share, blur) for one in turned[: len(frames)]]
                row = judged(places, scenes)
                two = np.mean([row[f"two_{away}_apart"] for away in APART])
                both = row["lone_counted"] + two
                for key, value in (("lone", row["lone_median_mm"]), ("counted", -both)):
                    if key not in best or value < best[key][0]:
                        best[key] = value, row
    row = best["counted"][1] | {
        k: best["lone"][1][k] for k in ("lone_median_mm", "lone_p90_mm")
    }
    marks = np.array(marks).max(0)
    return [{"skin": name, "method": "pyEIT, best in hindsight"} | row | letter_row(marks)]


def letter_images(name: str) -> list[np.ndarray]:
    raster, (middle, high) = Raster(name), letter_place(name)
    at = (raster.x - middle) / high, (raster.y - middle) / high
    return [letter(c, *at) & raster.on for c in LETTERS]


def letter_place(name: str) -> tuple[float, float]:
    return (0.08, 0.045) if name == "grid" else (0.0, 0.03)


def letter_row(marks) -> dict:
    return {f"letter_{c}": float(m) for c, m in zip(LETTERS, marks)}


def likeness(raster: Raster, image: np.ndarray, truth: np.ndarray) -> float:
    """Correlation with the truth over the sheet."""
    return float(np.corrcoef(image[raster.on], truth[raster.on])[0, 1])


def drawn(name: str, scenes: dict, letters: np.ndarray, noise: float) -> tuple:
    """Our images of letters: Eq. 3 by `jacobian`, and on a rim `Levels`."""
    import jax.numpy as jnp

    from tomojax import ert
    from tomojax.kernels import inverse

    raster, pairs, truth = Raster(name), pairs_of(name), letter_images(name)
    recording = recording_of(name, scenes["xy"], letters)
    sensor = recording.sensor(float)
    j = np.asarray(ert.jacobian(sensor, pairs))
    shape = j.shape[2:]
    j = j.reshape(letters[0].size, -1)
    lines = [(np.arange(n) + 0.5) * s / n + o
             for n, s, o in zip(shape, recording.box, recording.origin)]  # fmt: skip
    points = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 2)
    # Cells count by their sensitivity, or all is drawn at electrodes.
    scale = np.linalg.norm(j, axis=0) ** 0.5
    scale = np.where(scale > 1e-3 * scale.max(), scale, np.inf)
    rows_of = jnp.asarray((j / scale).reshape(*letters[0].shape, -1), np.float32)
    told = inverse.spectrum(rows_of)
    grid = inverse.lambda_grid(told)
    images, rows = [], []
    for one in jnp.asarray(letters, np.float32):
        scores = inverse.lambda_scores(told, one, grid, "cautious", np.float32(noise))
        lam = inverse.choose_lambda(grid, scores)
        damped = told.singular / (told.singular**2 + lam)
        weights = np.asarray(damped * jnp.einsum("smr,sm->r", told.left, one))
        u = np.asarray(told.left).reshape(len(j), -1)
        back = (u * (weights / np.maximum(np.asarray(told.singular), 1e-30))).sum(1)
        images.append(-(j / scale).T @ back / scale)
    images = raster.of(points, np.stack(images).T)
    marks = [likeness(raster, one, t) for one, t in zip(images, truth)]
    rows.append({"skin": name, "method": "Eq. 3"} | letter_row(marks))
    if name == "rim":
        levels = levels_of(scenes)
        images = np.stack([
            np.nan_to_num(-levels.model.image(levels(scenes["empty"] + one).conductance,
                                              raster.line, raster.line), nan=-1.0)
            for one in letters
        ])  # fmt: skip
        marks = [likeness(raster, one, t) for one, t in zip(images, truth)]
        rows.append({"skin": name, "method": "Levels"} | letter_row(marks))
    return rows, images


def jacobians(rounds: int) -> dict:
    """Times J of 16 opposite injections on a disc, beside pyEIT's; calls take turns."""
    import jax
    from pyeit.eit.fem import EITForward
    from pyeit.eit.protocol import PyEITProtocol

    import tomojax as tx

    turn = 2 * np.pi * np.arange(16) / 16
    xy = 0.05 * np.stack([np.cos(turn), np.sin(turn)], 1)
    pairs = tx.ert.Pairs.opposite(16)
    sensor = tx.Sensor.disc(0.1, xy + 0.05, electrode_diameter=0.0098, divisions=(48, 48))
    import pyeit.mesh as mesh

    body = mesh.create(16, h0=0.045, p_fix=xy / 0.05)
    told = PyEITProtocol(pairs.inject, pairs.read, np.ones(192, bool))
    forward = EITForward(body, told)
    runs = {
        "tomojax": lambda: jax.block_until_ready(tx.ert.jacobian(sensor, pairs)),
        "pyeit": lambda: forward.compute_jac(1.0),
    }
    found = np.asarray(runs["tomojax"]())
    on = abs(found).max((0, 1)) > 1e-6 * abs(found).max()
    times = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            for _ in range(5 if name == "tomojax" else 1):
                begun = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - begun)
    row = {f"{name}_s": float(np.median(each)) for name, each in times.items()}
    row |= {f"{name}_least_s": float(min(each)) for name, each in times.items()}
    row |= {"tomojax_elements": 2 * int(on.sum()), "pyeit_elements": len(body.element)}
    return row | {"ratio": row["pyeit_s"] / row["tomojax_s"], "rounds": rounds}


def draw(rows: list[dict], path: Path) -> None:
    """Draws which part of pairs is told apart by distance, and how far off they are."""
    from matplotlib.figure import Figure

    figure = Figure((4.2 * len(SKINS), 7.4), layout="constrained")
    for column, name in zip(figure.subplots(2, len(SKINS)).T, SKINS):
        for row in (r for r in rows if r["skin"] == name and "two_8_median_mm" in r):
            style = {"bound": "k:", "pyEIT, best in hindsight": "s--"}.get(
                row["method"], "o-"
            )
            off = [row[f"two_{a}_median_mm"] for a in APART]
            off = [np.nan if v is None else v for v in off]
            column[1].plot(APART, off, style, ms=4, label=row["method"])
            if row["method"] != "bound":
                part = [row[f"two_{a}_apart"] for a in APART]
                column[0].plot(APART, part, style, ms=4, label=row["method"])
        column[0].set(title=name, ylabel="pairs told apart", ylim=(-0.03, 1.03))
        column[1].set(yscale="log", ylabel="place error, median, mm")
        column[1].set_xlabel("distance of two presses, mm")
        column[1].legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measures each skin."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(SKINS))
    parser.add_argument("--seeds", type=int, default=1, help="noise, drawn so many times")
    parser.add_argument("--voltages", type=Path, help="folder that keeps voltages")
    parser.add_argument("--rounds", type=int, default=9, help="of timed Jacobians")
    parser.add_argument("--output", type=Path, default=RESULTS)
    told = parser.parse_args()
    from tomojax._environment import environment

    warnings.simplefilter("ignore")
    summary = {"jacobian": jacobians(told.rounds), "noise_part": NOISE, "seeds": told.seeds}
    print(summary, flush=True)
    out = told.output / "simulated_skins.json"
    before = json.loads(out.read_text())["rows"] if out.is_file() else []
    rows = [row for row in before if row["skin"] not in told.only]
    for name in told.only:
        scenes = made(name, told.voltages)
        volts = np.tile(scenes["volts"], (told.seeds, 1, 1))
        noise = NOISE * float(np.sqrt((volts**2).mean()))
        rng = np.random.default_rng(1)
        frames = volts + noise * rng.normal(size=volts.shape)
        letters = scenes["letters"] + noise * rng.normal(size=scenes["letters"].shape)
        n = len(scenes["volts"])
        fresh = [*ours(name, scenes, frames, noise), bound(name, scenes, noise)]
        fresh += drawn(name, scenes, letters, noise)[0]
        fresh += pyeit(name, scenes, frames[:n], letters)
        for row in fresh:
            print("  ".join(f"{k} {v}" for k, v in row.items()), flush=True)
        rows += fresh
        written = {"rows": rows, "summary": summary, "environment": environment()}
        out.write_text(json.dumps(written, indent=1) + "\n")
    draw(rows, told.output / "simulated_skins.png")


if __name__ == "__main__":
    main()
