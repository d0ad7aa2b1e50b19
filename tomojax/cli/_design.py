"""`tomojax design`: chooses grounds for the places where contacts may be."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from tomojax._require import require
from tomojax._whole import whole, write_text
from tomojax.cli.entry import (
    Command,
    ground_numbers,
    InputFile,
    NUMBER,
    OutputFile,
    OutputFolder,
    sheet_of,
)

# What a criterion is of, in a picture.
_WORDS = {
    "place": "error of place",
    "a": "variance",
    "d": "volume of what stays unknown",
    "worst": "largest error",
    "rigs": "error on simulated rigs",
}

# Cells of the map of what a design tells, along a side.
_MAP = 32


@click.command(cls=Command)
@click.option(
    "--region",
    type=NUMBER,
    nargs=4,
    metavar="X0 Y0 X1 Y1",
    help="Design for contacts in this rectangle, mm. [default: the sheet without a rim "
    "of half a pitch]",
)
@click.option(
    "--place",
    "spots",
    type=NUMBER,
    nargs=2,
    multiple=True,
    help="Design for a contact at X Y, mm. May be repeated.",
)
@click.option(
    "--slots", type=int, default=8, show_default=True, help="Ground so many electrodes."
)
@click.option(
    "--grounds",
    metavar="E,E,…",
    help="Rate these electrodes as well, as 0,7,14: the row `yours` of the table.",
)
@click.option(
    "--method",
    type=click.Choice(["points", "linear", "source"]),
    default="points",
    show_default=True,
    help="Choose the grounds for this method.",
)
@click.option(
    "--criterion",
    type=click.Choice(["place", "a", "d", "worst", "rigs"]),
    help="Make one figure small. `place`: a contact's mean error of place. `a`: the mean "
    "variance. `d`: the volume of what stays unknown. `worst`: the worst place's "
    "figure. `rigs`: the error on simulated rigs. [default: place; rigs for the "
    "--policy table of points or linear]",
)
@click.option("--noise", type=NUMBER, help="Assumed noise, V rms. [default: the method's]")
@click.option("--lam", type=NUMBER, help="Image's regularisation λ. [default: by noise]")
@click.option(
    "--contacts",
    type=int,
    default=64,
    show_default=True,
    help="Spread this many contacts over the region.",
)
@click.option(
    "--like",
    type=InputFile(),
    help="Take the sheet and electrodes from this recording of the rig. [default: "
    "the paper's sensor]",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report", makes=True),
    help="Write the whole report here; replaces an earlier report.",
)
@click.option("--out", type=OutputFolder("design.png"), help="Folder for a picture.")
@click.option(
    "--policy",
    type=OutputFile("policy", makes=True),
    help="Write a table of grounds by place to this .npz file as well, for `tomojax live "
    "--policy`; replaces an earlier table.",
)
def design(
    region: tuple | None,
    spots: tuple,
    grounds: str | None,
    json_path: Path | None,
    out: Path | None,
    policy: Path | None,
    like: Path | None,
    **options: Any,
) -> None:
    """Choose the electrodes to ground for locating contacts best.

    The command prints the chosen grounds, and how far they are from the best possible. The
    paper's nine patterns follow for comparison. Beside each pattern stands a design of as
    many slots.
    """
    for folder in (out, json_path and json_path.parent, policy and policy.parent):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    if policy is not None and policy.suffix != ".npz":
        raise ValueError(f"--policy: got {policy}, expected a name that ends in .npz")
    if region and spots:
        raise ValueError("--place: got a region as well, expected one of both")
    rig, size, electrodes = sheet_of(like)
    if region:
        _check_region(region, size)
    own = _own(grounds, electrodes)

    import jax
    import numpy as np

    from tomojax._environment import environment
    from tomojax.sensor import Sensor

    # Variances of a small λ want all digits.
    with jax.enable_x64(True):
        sensor = Sensor.grid(divisions=(32, 32), dtype=np.float64)
        if rig is not None:
            sensor = rig.sensor(dtype=np.float64)
        report = _designed(sensor, region, spots, own, options)
        print(_text(report))
        if json_path:
            told = {k: v for k, v in report.items() if not k.startswith("_")}
            told["environment"] = environment()
            text = json.dumps(told, indent=1).replace("NaN", "null")
            write_text(json_path, text + "\n")
        if out:
            path = out / "design.png"
            with whole(path) as part:
                _draw(sensor, report).savefig(part, dpi=110)
            print(f"picture: {path}")
        if policy:
            _table(sensor, policy, options)


def _check_region(region: tuple, size: Any) -> None:
    """**Raises:** `ValueError` for an empty region, and for one off the sheet; mm and m."""
    x0, y0, x1, y1 = region
    text = ", ".join(f"{v:g}" for v in region)
    require(x0 < x1 and y0 < y1, "--region", text, "x0 < x1 and y0 < y1, mm")
    width, height = (1e3 * float(side) for side in size)
    inside = min(x0, y0) >= 0 and x1 <= width * (1 + 1e-6) and y1 <= height * (1 + 1e-6)
    require(inside, "--region", text, f"on the sheet, 0 to {width:g}, {height:g} mm")


def _own(grounds: str | None, electrodes: int) -> list[int]:
    """Reads the electrodes of `--grounds`; none where there is no such option."""
    if grounds is None:
        return []
    found = ground_numbers("--grounds", grounds, electrodes)
    if found is None or len(set(found)) < len(found):
        expected = "electrodes with commas, each once"
        raise ValueError(f"--grounds: got {grounds!r}, expected {expected}")
    return found


def _designed(
    sensor: Any, region: Any, spots: tuple, own: list[int], options: dict
) -> dict[str, Any]:
    import jax
    import numpy as np

    from tomojax import design as d, design as problem

    if spots:
        places = np.array(spots) / 1e3
    else:
        box = None if not region else np.array(region) / 1e3
        places = np.asarray(problem.design_places(sensor, box, options["contacts"]))
    words = {k: options[k] for k in ("noise", "lam")}
    criterion = options["criterion"] or "place"

    def objective(where: Any) -> Any:
        return problem.design_objective(
            sensor, where, options["method"], criterion, **words
        )

    with click.progressbar(length=3, label="design", file=sys.stderr) as bar:
        made = objective(places)
        found = d.design(made, options["slots"])
        bar.update(1)
        explored = problem.exploratory_voltages(sensor, jax.numpy.asarray(places))
        rows = d.patterns_beside(sensor, made, explored)
        rows = ([_yours(made, own)] if own else []) + rows
        # What knows the contact is beside designs that do, the others beside one for all.
        kinds = {(row["slots"], row["adaptive"]) for row in rows}
        best = {kind: _best(made, *kind) for kind in kinds}
        for row in rows:
            row["designed"] = best[row["slots"], row["adaptive"]]
        bar.update(1)
        parts = [(np.arange(_MAP) + 0.5) / _MAP * s for s in np.asarray(sensor.size)]
        grid = np.stack(np.meshgrid(*parts, indexing="ij"), -1).reshape(-1, 2)
        chosen = np.zeros(made.slots)
        chosen[found.grounds] = 1
        whole = criterion == "d" and options["method"] != "points"
        figures = None if whole else np.asarray(objective(grid)(jax.numpy.asarray(chosen)))
        bar.update(1)
    gap = found.value / found.bound - 1
    return {
        "rows": rows,
        "summary": {
            "grounds": found.grounds.tolist(),
            "lam": None if options["method"] == "points" else float(made.lam),
            "objective": found.value,
            "bound": found.bound,
            "gap": gap,
            "unit": found.unit,
            "greedy": found.greedy,
            "rounded": found.rounded,
            "method": options["method"],
            "criterion": criterion,
            "baselines": {row["name"]: row["value"] for row in rows},
        },
        "_places": places,
        "_map": None if figures is None else figures.reshape(_MAP, _MAP),
    }


def _yours(objective: Any, grounds: list[int]) -> dict[str, Any]:
    """A row of the table, as those of the paper's patterns."""
    import jax.numpy as jnp
    import numpy as np

    weights = np.zeros(objective.slots)
    weights[grounds] = 1
    value = float(objective.value(jnp.asarray(weights, objective.dtype)))
    return {"name": "yours", "slots": len(grounds), "value": value, "adaptive": False}


def _best(objective: Any, slots: int, by_place: bool) -> float:
    from tomojax import design as d
    from tomojax.design import designs_by_place, ImageVariance

    if not by_place:
        return d.design(objective, slots).value
    if isinstance(objective, ImageVariance) and objective.criterion == "d":
        return float("nan")  # one figure for all contacts
    figures = d.each_its_own(objective, designs_by_place(objective, slots)[0])
    return float(figures.max() if objective.worst else figures.mean())


def _text(report: dict[str, Any]) -> str:
    s = report["summary"]
    scale, unit = (1e3, "mm") if s["unit"] == "m" else (1.0, s["unit"])
    grounds = " ".join(map(str, s["grounds"]))
    bound = f"{scale * s['bound']:.4g} ({100 * s['gap']:.1f} %)"
    beside = f"; no set of as many is below {bound}" if s["gap"] == s["gap"] else ""
    lines = [
        f"grounds: {grounds}",
        *([] if s["lam"] is None else [f"λ: {s['lam']:.4g}"]),
        f"objective: {scale * s['objective']:.4g} {unit}{beside}",
        f"{'pattern':12s} slots  {'its own':>10s}  designed, {unit}",
    ]
    for row in report["rows"]:
        mark = "*" if row["adaptive"] else " "
        known = [row[key] for key in ("value", "designed")]
        own, best = (f"{scale * v:.4g}" if v == v else "-" for v in known)
        values = f"{own:>10s}  {best:>8s}"
        lines.append(f"{row['name']:11s}{mark} {row['slots']:5d}  {values}")
    known = "* knows where the contact is, and so does the design beside it: --policy"
    return "\n".join([*lines, known])


def _table(sensor: Any, path: Path, options: dict) -> None:
    from tomojax.design import design_policy
    from tomojax.step import save_policy

    words = {k: options[k] for k in ("noise", "lam", "criterion")}
    words = {k: v for k, v in words.items() if v is not None}
    found = design_policy(sensor, options["slots"], options["method"], **words)
    save_policy(found.policy, path)
    nx, ny = found.value.shape
    worst = 100 * float((found.value / found.bound - 1).max())
    told = f", each {worst:.1f} % off its bound at most" if worst == worst else ""
    print(f"policy: {path}, {nx} x {ny} places{told}")


def _draw(sensor: Any, report: dict[str, Any]) -> Any:
    import numpy as np
    from matplotlib.figure import Figure

    from tomojax._pictures import (
        lay_sheet,
        name_points,
        plain,
        show_image,
        style,
        VALUE,
        VERMILION,
    )

    s = report["summary"]
    scale, unit = (1e3, "mm") if s["unit"] == "m" else (1.0, s["unit"])
    figure = Figure(figsize=(14, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    xy = 1e3 * np.asarray(sensor.electrode_xy)
    word = _WORDS[s["criterion"]]
    figure.suptitle(f"Grounds designed for {s['method']}: the least {word}")
    if report["_map"] is not None:
        image = scale * report["_map"]
        label = f"{word} there, {unit}"
        show_image(left, image, sensor.size, label, cmap=f"{VALUE}_r", norm="log")
    lay_sheet(left, sensor.size, sensor.electrode_xy, float(sensor.electrode_diameter))
    left.plot(*1e3 * report["_places"].T, "k.", ms=2)
    for order, ground in enumerate(s["grounds"], 1):
        left.plot(*xy[ground], "o", color=VERMILION, ms=11)
        left.text(*xy[ground], str(order), color="w", ha="center", va="center", size=8)
    left.set_title(f"{len(s['grounds'])} grounds in order; dots: contacts")
    rows = sorted(report["rows"], key=lambda row: row["slots"])
    for row in rows:
        mark = "^" if row["adaptive"] else "o"
        right.loglog(row["slots"], scale * row["value"], mark, color="0.4", ms=5)
    for adaptive, k, label in ((False, 0, "one for all"), (True, 2, "by place")):
        some = [row for row in rows if row["adaptive"] == adaptive]
        values = [scale * row["designed"] for row in some]
        slots = [row["slots"] for row in some]
        right.loglog(slots, values, **style(k, label=f"designed, {label}"))
    right.loglog([], [], "o", color="0.4", ms=5, label="pattern")
    right.loglog([], [], "^", color="0.4", ms=5, label="pattern that knows the contact")
    at = len(s["grounds"]), scale * s["objective"]
    right.loglog(
        *at, "*", color=VERMILION, ms=12, ls="none", label="the design on the left"
    )
    name_points(
        right,
        [
            (row["name"].replace("_", " "), row["slots"], scale * row["value"])
            for row in rows
        ],
    )
    right.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    slots = sorted({row["slots"] for row in rows})
    right.set_xticks(slots, [str(n) for n in slots], minor=False)
    right.set_xticks([], minor=True)
    plain(right.yaxis)
    right.set(xlabel="slots", ylabel=f"{word}, {unit}")
    right.set_title("Patterns and designs, the lower the better")
    return figure
