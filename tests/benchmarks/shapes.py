"""Measures images of shapes on rigs of other models, beside the other images.

    python tests/benchmarks/shapes.py [--rigs 10] [--scenes 12] [--seed N] [--only PART]

Shapes are letters, digits, hands, feet, tools, rings, cables, frames and two objects. They
are 30 to 140 mm large, with strokes of 8 to 30 mm, at any place and turn. They conduct
0.005 to 5 S/m², and are pressed evenly, softly, or through a resistance. Every second rig
is a resistor network, every other one of finite elements (`bench.rigs`), drawn by
default. Nominal values are told; `calibrated` rows have a calibration of 40 contacts at
unknown places.

The image of `shape` is judged at its own half level. The others' images are judged at the
threshold that is best for each in hindsight. Parts: images, digits, gaps, patterns; speed
alone; gallery, a picture alone. The default seeds are for judging: nothing was set on
them. Writes shapes.json, shapes.png, shapes_gallery.png.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage, signal

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"
SLOTS = {
    "2": [0, 63],
    "10": [0, 7, 56, 63, 3, 24, 31, 60, 27, 36],
    "64": list(range(64)),
}
OTHERS = ("linear", "source")
FINE = 160  # pixels of a side of what images are compared on
GAPS = (4, 6, 8, 10, 12, 15, 20, 25)  # mm
PRESSED = (0.02, 0.2, 2.0)  # S/m², of gaps and holes
PARTS = ("images", "digits", "gaps", "patterns")  # and speed, alone


def raster(size: np.ndarray) -> np.ndarray:
    """The centres of the fine pixels (FINE², 2), m."""
    part = (np.arange(FINE) + 0.5) / FINE
    return np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2) * size


def finer(image: np.ndarray) -> np.ndarray:
    """An image on the fine pixels, linear between its own."""
    at = [(np.arange(FINE) + 0.5) / FINE * n - 0.5 for n in image.shape]
    grid = np.stack(np.meshgrid(*at, indexing="ij"))
    return ndimage.map_coordinates(np.asarray(image, float), grid, order=1, mode="nearest")


def overlap(found: np.ndarray, truth: np.ndarray) -> float:
    return float((found & truth).sum() / max(1, (found | truth).sum()))


def ssim(truth: np.ndarray, found: np.ndarray, width: float) -> float:
    """Structural similarity under a Gaussian window, as KTC 2023 scores it (width 80 of
    256 pixels there; Räsänen et al., 2024)."""
    r = np.arange(-int(np.ceil(2 * width)), int(np.ceil(2 * width)) + 1)
    window = np.exp(-(r**2) / (2 * width**2))
    window = window[:, None] * window

    def mean(a: np.ndarray) -> np.ndarray:
        return signal.fftconvolve(a, window, "same") / whole

    whole = signal.fftconvolve(np.ones(truth.shape), window, "same")
    t, f = mean(truth), mean(found)
    tt, ff = mean(truth**2) - t**2, mean(found**2) - f**2
    tf = mean(truth * found) - t * f
    c1, c2 = 1e-4, 9e-4
    both = (2 * t * f + c1) * (2 * tf + c2)
    return float((both / ((t**2 + f**2 + c1) * (tt + ff + c2))).mean())


def rim(inside: np.ndarray) -> np.ndarray:
    """The pixels of an outline: inside, with a neighbour that is not."""
    return inside & ~ndimage.binary_erosion(inside, border_value=1)


def outline_distances(found: np.ndarray, truth: np.ndarray, side: float) -> np.ndarray:
    """From each outline's pixels to the other outline, both ways, in the unit of `side`."""
    a, b = rim(found), rim(truth)
    if not a.any() or not b.any():
        return np.array([np.nan])
    away = [ndimage.distance_transform_edt(~r) for r in (a, b)]
    return side / FINE * np.concatenate([away[1][a], away[0][b]])


def judged(
    image: np.ndarray,
    level: float | None,
    truth: np.ndarray,
    mm: float,
    scale: np.ndarray | None = None,
) -> dict:
    """Figures of an image against what touched; `level` None: the best in hindsight.

    `scale`: the image that correlation and similarity are of, where it is another one.
    """
    up = finer(image)
    if level is None:
        levels = np.linspace(0.03, 0.95, 47) * up.max()
        level = float(levels[np.argmax([overlap(up > one, truth) for one in levels])])
    found = up > level
    away = outline_distances(found, truth, mm)
    drawn = up if scale is None else finer(scale)
    flat, real = drawn.ravel(), truth.ravel().astype(float)
    spread = flat.std() * real.std()
    top = (drawn**2).sum() / max(float(drawn.sum()), 1e-30)
    scaled = np.clip(drawn / max(top, 1e-30), 0, 1)
    return {
        "overlap": overlap(found, truth),
        "correlation": float(np.cov(flat, real)[0, 1] / spread) if spread > 0 else 0.0,
        "ssim": ssim(truth.astype(float), scaled, 1.5 * FINE / 64),
        "ktc": ssim(truth.astype(float), found.astype(float), 80 * FINE / 256),
        "outline_mm": float(np.nanmean(away)) if np.isfinite(away).any() else None,
        "outline_95_mm": float(np.nanquantile(away, 0.95)) if len(away) > 1 else None,
        "area_error": float(found.sum() / truth.sum() - 1),
    }


def rig_of(number: int, seed: int) -> tuple[Any, Any, np.random.Generator]:
    """A rig, the model that makes its voltages, and what draws."""
    import tomojax as tx
    from bench.rigs import draw_rig, Elements, network_of

    rng = np.random.default_rng([seed, number])
    rig = draw_rig(tx.Sensor.grid(dtype=np.float32), rng)
    return rig, (Elements if number % 2 else network_of)(rig), rng


def read(rig: Any, exact: Any, strokes: Any, rng: np.random.Generator) -> np.ndarray:
    """All grounds' voltages as read, less zeros as a tare of 20 slots finds them."""
    grounds = np.arange(rig.sensor.electrode_count)
    return rig.chain.read(exact.touched(strokes, grounds), rng) - tared(rig, rng)


def tared(rig: Any, rng: np.random.Generator) -> np.ndarray:
    """The channels' zeros as a mean of 20 slots without a contact finds them, V."""
    quiet = np.zeros((20, 1, rig.sensor.electrode_count))
    return rig.chain.read(quiet, rng).mean((0, 1))


def middle_for(size: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
    """A place at which a circle of that radius is on the sheet, or the middle."""
    room = np.maximum(size / 2 - reach, 0)
    return size / 2 + room * rng.uniform(-1, 1, 2)


def draw_scene(size: np.ndarray, rng: np.random.Generator, wide: bool) -> Any:
    """A shape: strokes of 12 to 16 mm, 0.02 to 2 S/m²; `wide`: of all kinds."""
    from bench.rigs import draw_strokes, GLYPHS, THINGS

    mm, laws = 1e-3, {}
    decades = (-2.3, 0.7) if wide else (-1.7, 0.3)
    per_area = 10 ** rng.uniform(*decades)
    if wide:
        law = rng.integers(3)
        laws = [{}, {"soft": 1.0}, {"series": 1e4}][law]
    while True:
        name = str(rng.choice([*GLYPHS, *THINGS]))
        width = rng.uniform(8, 30) * mm if wide else rng.uniform(12, 16) * mm
        height = rng.uniform(30, 140) * mm if wide else rng.uniform(70, 120) * mm
        if name in GLYPHS and height < 4.5 * width:
            continue
        turn = (
            rng.uniform(0, 2 * np.pi) if wide or name in THINGS else rng.uniform(-0.5, 0.5)
        )
        made = draw_strokes(name, size / 2, height, turn, per_area, width, **laws)
        if name in THINGS and not wide:
            thick = np.median(made.widths)
            if not 11 * mm <= thick <= 17 * mm and name not in ("hand", "foot", "two"):
                continue
        reach = made.half_axes[0]
        if reach > size.min() / 2 - 2 * mm:
            continue
        at = size / 2 + middle_for(size, reach + 2 * mm, rng) - made.xy
        return (
            name,
            width,
            height,
            draw_strokes(name, at, height, turn, per_area, width, **laws),
        )


def touched_for(rig: Any, exact: Any, rng: np.random.Generator) -> tuple:
    """What a calibration is made of: 40 contacts at unknown places, ten slots each."""
    from bench.rigs import draw_touch

    grounds = np.array(
        [[0, 63, *rng.choice(np.arange(1, 63), 8, replace=False)] for _ in range(40)]
    )
    volts = [
        rig.chain.read(exact.touched(draw_touch(rig.sensor, "usual", rng), g), rng)
        for g in grounds
    ]
    less = np.array(volts) - tared(rig, rng)
    return less.astype(np.float32), grounds


def images_of(
    number: int, seed: int, scenes: int, only: tuple = ()
) -> tuple[list[dict], list[tuple]]:
    """Rows of one rig's scenes, and what is drawn of some.

    `only`: of these methods, values and slots; all without.
    """
    import tomojax as tx

    rig, exact, rng = rig_of(number, seed)
    size = np.asarray(rig.sensor.size, float)
    rub = touched_for(rig, exact, rng)
    drawn = [(draw_scene(size, rng, wide=k % 2 == 1), k % 2 == 1) for k in range(scenes)]
    volts = np.stack([read(rig, exact, made[3], rng) for made, _ in drawn])
    truths = [
        (made[3].density(raster(size)) > 0.5).reshape(FINE, FINE) for made, _ in drawn
    ]
    rows, shown = [], []
    told = [("nominal", "shape"), ("calibrated", "shape")]
    told += [("nominal", name) for name in OTHERS]
    for values, name in told:
        if only and (name, values) not in [what[:2] for what in only]:
            continue
        calibrated = values == "calibrated"
        known = tx.calibration.calibrate(rig.sensor, *rub) if calibrated else None
        method = tx.method(rig.sensor, name, 32, known)
        right = volts if known is None else known.voltages(volts)
        for slots, grounds in SLOTS.items():
            if (
                name != "shape"
                and slots == "2"
                or only
                and (name, values, slots) not in only
            ):
                continue
            under = np.array(grounds)
            v = right[:, under].astype(np.float32)
            good = np.isfinite(v[0])
            lam = method.choose_lambda([tx.methods.Frame(w, under, good) for w in v])
            batch = tx.Batch(method, lam, contacts=8)
            found = batch(v, np.tile(under, (len(v), 1)))
            for k, (made, wide) in enumerate(drawn):
                image = found.touch[k] if name == "shape" else found.image[k]
                level = 0.5 if name == "shape" else None
                row = {"rig": number, "scene": k, "set": "wide" if wide else "usual"}
                row |= {"shape": made[0], "stroke_mm": 1e3 * made[1]}
                row |= {"height_mm": 1e3 * made[2], "S_per_m2": made[3].per_area}
                row |= {"soft": made[3].soft, "series_ohm": made[3].series}
                row |= {"method": name, "values": values, "slots": int(len(under))}
                row |= judged(image, level, truths[k], 1e3 * size[0], found.image[k])
                row["flags"] = int(found.flags[k])
                if name == "shape":
                    row["reliability"] = reliability(found.touch[k], truths[k])
                rows.append(row)
                if slots == "64" or name == "shape":
                    shown.append(
                        (number, k, name, values, slots, image, truths[k], made[0])
                    )
    return rows, shown


BINS = np.linspace(0, 1, 11)


def reliability(touch: np.ndarray, truth: np.ndarray) -> list[list[float]]:
    """For each tenth of the probability: pixels, Σ probability, those that touched."""
    up, real = finer(touch)[2::4, 2::4].ravel(), truth[2::4, 2::4].ravel()
    bins = np.clip(np.digitize(up, BINS) - 1, 0, 9)
    return [
        np.bincount(bins, w, 10).round(4).tolist() for w in (np.ones_like(up), up, real)
    ]


def digits_of(number: int, seed: int, turns: int) -> list[dict]:
    """Ten digits of one rig, told apart by the nearest outline."""
    import tomojax as tx
    from bench.rigs import draw_strokes

    rig, exact, rng = rig_of(number, seed + 1)
    size, names = np.asarray(rig.sensor.size, float), [str(k) for k in range(10)]
    cases, rows = [], []
    for name in names * turns:
        turn = np.radians(rng.uniform(-20, 20))
        place = size / 2 + rng.uniform(-0.015, 0.015, 2)
        strokes = draw_strokes(name, place, 0.08, turn, 10 ** rng.uniform(-1.7, 0.3), 0.013)
        cases.append((name, strokes.per_area, read(rig, exact, strokes, rng)))
    templates = [
        (
            name,
            draw_strokes(name, size / 2, 0.08, np.radians(turn), 1.0, 0.013).inside(
                raster(size)
            ),
        )
        for name in names
        for turn in range(-24, 25, 6)
    ]
    templates = [(name, t.reshape(FINE, FINE)) for name, t in templates]
    volts = np.stack([v for *_, v in cases])
    for method in ("shape", "linear", "source"):
        model = tx.method(rig.sensor, method, 32)
        for grounds in SLOTS.values():
            under = np.array(grounds)
            v = volts[:, under].astype(np.float32)
            lam = model.choose_lambda([tx.methods.Frame(w, under, w == w) for w in v])
            found = tx.Batch(model, lam)(v, np.tile(under, (len(v), 1)))
            for k, (name, per_area, _) in enumerate(cases):
                up = finer(found.touch[k] if method == "shape" else found.image[k])
                inside = up > (0.5 if method == "shape" else up.max() / 2)
                told = nearest(inside, templates)
                row = {"rig": number, "digit": name, "told": told, "method": method}
                rows.append(row | {"slots": len(under), "S_per_m2": per_area})
    return rows


def nearest(inside: np.ndarray, templates: list[tuple[str, np.ndarray]]) -> str:
    """The template whose outline is nearest, centre upon centre, or a little beside."""
    if not inside.any():
        return ""
    mine = rim(inside)
    away = ndimage.distance_transform_edt(~mine)
    points = np.argwhere(mine)
    best, told = np.inf, ""
    for name, template in templates:
        other = rim(template)
        shift = np.array(ndimage.center_of_mass(inside)) - ndimage.center_of_mass(template)
        far = ndimage.distance_transform_edt(~other)
        for beside in ((0, 0), (2, 0), (-2, 0), (0, 2), (0, -2)):
            by = np.round(shift + beside).astype(int)
            there = np.clip(np.argwhere(other) + by, 0, FINE - 1)
            back = np.clip(points - by, 0, FINE - 1)
            mean = away[tuple(there.T)].mean() + far[tuple(back.T)].mean()
            if mean < best:
                best, told = mean, name
    return told


def gaps_of(number: int, seed: int) -> list[dict]:
    """Two bars of 40 mm, and rings: whether the gap or the hole is seen."""
    import tomojax as tx
    from bench.rigs import Strokes

    rig, exact, rng = rig_of(number, seed + 2)
    size, rows, cases = np.asarray(rig.sensor.size, float), [], []
    for per_area in PRESSED:
        for gap in GAPS:
            mm, turn = 1e-3, rng.uniform(0, np.pi)
            along, at = (
                np.array([np.cos(turn), np.sin(turn)]),
                size / 2 + rng.uniform(-0.02, 0.02, 2),
            )
            across = np.array([-along[1], along[0]])
            apart = (gap + 12) / 2 * mm
            ends = np.array([-14, 14])[:, None] * mm * along
            bars = tuple(at + ends + s * apart * across for s in (-1, 1))
            cases.append(
                ("gap", gap, per_area, at, Strokes(bars, (0.012, 0.012), per_area))
            )
            round_ = np.linspace(0, 2 * np.pi, 40)
            circle = (gap / 2 + 6) * mm * np.stack([np.cos(round_), np.sin(round_)], 1)
            cases.append(
                ("hole", gap, per_area, at, Strokes((at + circle,), (0.012,), per_area))
            )
    volts = np.stack([read(rig, exact, made, rng) for *_, made in cases])
    for method in ("shape", "source"):
        model = tx.method(rig.sensor, method, 32)
        for grounds in SLOTS.values():
            under = np.array(grounds)
            v = volts[:, under].astype(np.float32)
            lam = model.choose_lambda([tx.methods.Frame(w, under, w == w) for w in v])
            found = tx.Batch(model, lam)(v, np.tile(under, (len(v), 1)))
            for k, (kind, gap, per_area, at, _) in enumerate(cases):
                up = finer(found.touch[k] if method == "shape" else found.image[k])
                inside = up > (0.5 if method == "shape" else up.max() / 2)
                dark = not inside[tuple((at / size * FINE).astype(int))]
                parts, holes = ndimage.label(inside)[1], ndimage.label(~inside)[1]
                seen = dark and (parts == 2 if kind == "gap" else holes == 2)
                row = {"rig": number, "kind": kind, "mm": gap, "S_per_m2": per_area}
                rows.append(
                    row | {"method": method, "slots": len(under), "seen": bool(seen)}
                )
    return rows


def speed_of(seed: int) -> list[dict]:
    """Milliseconds of a frame, alone and as a film's next; single and double precision."""
    import jax

    import tomojax as tx

    rig, exact, rng = rig_of(0, seed + 4)
    size, rows = np.asarray(rig.sensor.size, float), []
    drawn = [draw_scene(size, rng, wide=False)[3] for _ in range(10)]
    volts = np.stack([read(rig, exact, made, rng) for made in drawn])
    for dtype in (np.float32, np.float64):
        with jax.enable_x64(dtype == np.float64):
            sensor = tx.Sensor.grid(dtype=dtype)
            method = tx.method(sensor, "shape", 32)
            for slots, grounds in SLOTS.items():
                under = np.array(grounds)
                one = tx.Batch(method, 1.0)
                film = tx.Batch(method, 1.0, film=8)
                film_of = [1 + 0.002 * k for k in range(8)]
                alone, further = [], []
                for v in volts[:, under].astype(dtype):
                    many = np.stack([k * v for k in film_of])
                    for batch, some in ((one, v[None]), (film, many)):
                        g = np.tile(under, (len(some), 1))
                        batch(some, g)
                        start = time.perf_counter()
                        batch(some, g)
                        took = 1e3 * (time.perf_counter() - start)
                        (alone if len(some) == 1 else further).append(took)
                ahead = (np.array(further) - alone) / 7
                row = {"dtype": np.dtype(dtype).name, "slots": int(slots)}
                for name, some in (("first_ms", alone), ("next_ms", ahead)):
                    q = np.quantile(some, [0.5, 0.9])
                    row |= {name: float(q[0]), name.replace("ms", "p90_ms"): float(q[1])}
                rows.append(row)
                print(json.dumps(row), flush=True)
    return rows


def parts_of(job: tuple[str, int, int, int]) -> tuple[str, Any]:
    part, number, seed, scenes = job
    made = {
        "images": lambda: images_of(number, seed, scenes),
        "digits": lambda: digits_of(number, seed, 1),
        "gaps": lambda: gaps_of(number, seed),
        "patterns": lambda: patterns_of(number, seed, scenes),
    }
    return part, made[part]()


def summary(rows: list[dict]) -> list[dict]:
    """Medians of the images, by set, method, values told and slots."""
    found, keys = [], ("set", "method", "values", "slots")
    for key in dict.fromkeys(tuple(r[k] for k in keys) for r in rows):
        some = [r for r in rows if tuple(r[k] for k in keys) == key]
        row = dict(zip(keys, key)) | {"scenes": len(some)}
        for name in (
            "overlap",
            "correlation",
            "ssim",
            "ktc",
            "outline_mm",
            "outline_95_mm",
        ):
            values = [r[name] for r in some if r[name] is not None]
            row[name] = float(np.median(values))
        row["overlap_quarter"] = float(np.quantile([r["overlap"] for r in some], 0.25))
        row["area_error"] = float(np.median([abs(r["area_error"]) for r in some]))
        found.append(row)
    return found


def patterns_of(number: int, seed: int, scenes: int) -> list[dict]:
    """Usual scenes of one rig under the paper's patterns, and designed ones."""
    import tomojax as tx

    rig, exact, rng = rig_of(number, seed + 3)
    sensor, size = rig.sensor, np.asarray(rig.sensor.size, float)
    drawn = [draw_scene(size, rng, wide=False) for _ in range(scenes)]
    volts = np.stack([read(rig, exact, made[3], rng) for made in drawn])
    truths = [(m[3].density(raster(size)) > 0.5).reshape(FINE, FINE) for m in drawn]
    method = tx.method(sensor, "shape", 32)
    adaptive = {
        n: tx.paper.AdaptiveScan(sensor, n) for n in ("around", "cop_line", "point")
    }
    sets = {"corners": [0, 63]}
    for name in tx.paper.PATTERNS:
        if name not in adaptive:
            sets[name] = np.asarray(tx.paper.pattern(sensor, name)).tolist()
    objective = tx.design.shape_objective(sensor)
    for n in (2, 4, 6, 8, 10, 16):
        sets[f"designed {n}"] = tx.design.design(objective, n).grounds.tolist()
    rows = []
    for name, under in [*sets.items(), *((n, None) for n in adaptive)]:
        each = []
        for v in volts:
            # An adaptive scan's first two slots are the corners.
            explored = v[[0, 63]].astype(np.float32)
            mine = under or [0, 63, *np.asarray(adaptive[name](explored)[0]).tolist()]
            each.append(mine)
        for k, some in enumerate(each):
            found = tx.Batch(method, 1.0)(
                volts[k][some].astype(np.float32)[None], np.array([some])
            )
            value = overlap(finer(found.touch[0]) > 0.5, truths[k])
            row = {"rig": number, "pattern": name, "slots": len(some), "overlap": value}
            rows.append(row | {"designed": name.startswith("designed"), "grounds": some})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1_000_200)
    parser.add_argument("--only", choices=[*PARTS, "speed", "gallery"])
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    from benchmarks.physics import environment
    from benchmarks.shapes_drawn import draw, GALLERY, gallery

    path = options.out / "shapes.json"
    content = json.loads(path.read_text()) if path.exists() else {}
    if options.only == "speed":
        content["speed"] = speed_of(options.seed)
        path.write_text(json.dumps(content) + "\n")
        return
    if options.only == "gallery":
        made = (images_of(k, options.seed, options.scenes, tuple(GALLERY)) for k in (0, 1))
        shown = [one for _, some in made for one in some]
        return gallery(shown, options.out / "shapes_gallery.png")
    start = time.monotonic()
    parts = [options.only] if options.only else list(PARTS)
    jobs = [
        (part, k, options.seed, options.scenes)
        for part in parts
        for k in range(max(2, options.rigs // (1 if part in ("images", "digits") else 2)))
    ]
    gathered: dict[str, list] = {part: [] for part in parts}
    shown = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, context) as pool:
        for done, (part, made) in enumerate(pool.map(parts_of, jobs), 1):
            gathered[part] += made[0] if part == "images" else made
            shown += made[1] if part == "images" else []
            print(f"{done} of {len(jobs)}, {time.monotonic() - start:.0f} s", flush=True)
    content |= gathered | {"environment": environment(), "seed": options.seed}
    if "images" in gathered:
        content["rows"] = summary(gathered["images"])
        gallery(shown, options.out / "shapes_gallery.png")
    if "patterns" in gathered:
        content["patterns"] = by_pattern(gathered["patterns"])
    path.write_text(json.dumps(content) + "\n")
    draw(content, path.with_suffix(".png"))
    for row in content.get("rows", []):
        rounded = {k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}
        print(json.dumps(rounded))


def by_pattern(rows: list[dict]) -> list[dict]:
    """The median overlap of each pattern's scenes."""
    found = []
    for name in dict.fromkeys(r["pattern"] for r in rows):
        some = [r for r in rows if r["pattern"] == name]
        row = {key: some[0][key] for key in ("pattern", "slots", "designed", "grounds")}
        values = [r["overlap"] for r in some]
        row |= {"overlap": float(np.median(values)), "scenes": len(some)}
        row["overlap_quarter"] = float(np.quantile(values, 0.25))
        found.append(row)
    return found


if __name__ == "__main__":
    main()
