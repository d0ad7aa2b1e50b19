"""`tomojax design`: chooses grounds for the places where contacts may be."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import require
from tomojax.cli import entry
from tomojax.cli._design_shown import draw, text

# Cells of the map of what a design tells, along a side.
_MAP = 32


@click.command(cls=entry.Command)
@click.option(
    "--region",
    type=entry.NUMBER,
    nargs=4,
    metavar="X0 Y0 X1 Y1",
    help="Design for contacts in this rectangle, mm. [default: the sheet without a rim "
    "of half a pitch]",
)
@click.option(
    "--place",
    "spots",
    type=entry.NUMBER,
    nargs=2,
    multiple=True,
    help="Design for a contact at X Y, mm. May be repeated.",
)
@click.option("--slots", default=8, help="Ground so many electrodes.")
@click.option(
    "--grounds",
    metavar="E,E,…",
    help="Rate these electrodes as well, as 0,7,14: the row `yours` of the table.",
)
@click.option(
    "--method",
    type=click.Choice(["points", "linear", "source"]),
    default="points",
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
@click.option(
    "--noise", type=entry.NUMBER, help="Assumed noise, V rms. [default: the method's]"
)
@click.option(
    "--lam", type=entry.NUMBER, help="Image's regularisation λ. [default: by noise]"
)
@click.option("--contacts", default=64, help="Spread this many contacts over the region.")
@entry.like_option
@entry.json_option("the whole report", makes=True)
@click.option("--out", type=entry.OutputFolder("design.png"), help="Folder for a picture.")
@click.option(
    "--policy",
    type=entry.OutputFile("policy", makes=True),
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
    rig, size, electrodes = entry.sheet_of(like)
    if region:
        _check_region(region, size)
    own = _own(grounds, electrodes)

    import jax
    import numpy as np

    from tomojax.sensor import Sensor

    # Variances of a small λ want all digits.
    with jax.enable_x64(True):
        sensor = Sensor.grid(divisions=(32, 32), dtype=np.float64)
        if rig is not None:
            sensor = rig.sensor(dtype=np.float64)
        places = _places(sensor, region, spots, options["contacts"])
        rows, summary, figures = _designed(sensor, places, own, options)
        print(text(rows, summary))
        entry.write_report(json_path, rows=rows, summary=summary)
        if out:
            figure = draw(sensor, rows, summary, places, figures)
            entry.save_picture(figure, out / "design.png")
        if policy:
            _table(sensor, policy, options)


def _check_region(region: tuple, size: Any) -> None:
    """**Raises:** `ValueError` for an empty region, and for one off the sheet; mm and m."""
    x0, y0, x1, y1 = region
    text = ", ".join(f"{v:g}" for v in region)
    require(x0 < x1 and y0 < y1, "--region", text, "x0 < x1 and y0 < y1, mm")
    require(min(x1 - x0, y1 - y0) >= 1, "--region", text, "sides of 1 mm or more, in mm")
    width, height = (1e3 * float(side) for side in size)
    inside = min(x0, y0) >= 0 and x1 <= width * (1 + 1e-6) and y1 <= height * (1 + 1e-6)
    require(inside, "--region", text, f"on the sheet, 0 to {width:g}, {height:g} mm")


def _own(grounds: str | None, electrodes: int) -> list[int]:
    """Reads the electrodes of `--grounds`; none where there is no such option."""
    if grounds is None:
        return []
    found = entry.ground_numbers("--grounds", grounds, electrodes)
    if found is None or len(set(found)) < len(found):
        expected = "electrodes with commas, each once"
        raise ValueError(f"--grounds: got {grounds!r}, expected {expected}")
    return found


def _places(sensor: Any, region: Any, spots: tuple, contacts: int) -> Any:
    """Returns the places (P, 2), m, that are designed for."""
    import numpy as np

    from tomojax.design import design_places

    if spots:
        return np.array(spots) / 1e3
    box = None if not region else np.array(region) / 1e3
    return np.asarray(design_places(sensor, box, contacts))


def _designed(
    sensor: Any, places: Any, own: list[int], options: dict
) -> tuple[list[dict[str, Any]], dict[str, Any], Any]:
    """Returns the table's rows, the summary, and a map of figures where there is one."""
    import jax
    import numpy as np

    from tomojax import design as room
    from tomojax.kernels.sheet import cell_centres

    words = {k: options[k] for k in ("noise", "lam")}
    method, criterion = options["method"], options["criterion"] or "place"

    def objective(where: Any) -> Any:
        return room.design_objective(sensor, where, method, criterion, **words)

    with entry.Progress("design:") as progress:
        progress.say("the grounds")
        made = objective(places)
        found = room.design(made, options["slots"])
        progress.say("designs beside the patterns")
        explored = room.exploratory_voltages(sensor, jax.numpy.asarray(places))
        rows = room.patterns_beside(sensor, made, explored)
        rows = ([_yours(made, own)] if own else []) + rows
        # What knows the contact is beside designs that do, the others beside one for all.
        kinds = {(row["slots"], row["adaptive"]) for row in rows}
        best = {kind: _best(made, *kind) for kind in kinds}
        for row in rows:
            row["designed"] = best[row["slots"], row["adaptive"]]
        progress.say("the map")
        figures = None
        if criterion != "d" or method == "points":  # else one figure for all places
            grid = cell_centres((_MAP, _MAP)) * np.asarray(sensor.size)
            chosen = np.zeros(made.slots)
            chosen[found.grounds] = 1
            figures = np.asarray(objective(grid)(jax.numpy.asarray(chosen)))
            figures = figures.reshape(_MAP, _MAP)
    summary = {
        "grounds": found.grounds.tolist(),
        "lam": None if method == "points" else float(made.lam),
        "objective": found.value,
        "bound": found.bound,
        "gap": found.value / found.bound - 1,
        "unit": found.unit,
        "greedy": found.greedy,
        "rounded": found.rounded,
        "method": method,
        "criterion": criterion,
        "baselines": {row["name"]: row["value"] for row in rows},
    }
    return rows, summary, figures


def _yours(objective: Any, grounds: list[int]) -> dict[str, Any]:
    """A row of the table, as those of the paper's patterns."""
    import jax.numpy as jnp
    import numpy as np

    weights = np.zeros(objective.slots)
    weights[grounds] = 1
    value = float(objective.value(jnp.asarray(weights, objective.dtype)))
    return {"name": "yours", "slots": len(grounds), "value": value, "adaptive": False}


def _best(objective: Any, slots: int, by_place: bool) -> float:
    from tomojax import design as room

    if not by_place:
        return room.design(objective, slots).value
    if isinstance(objective, room.ImageVariance) and objective.criterion == "d":
        return float("nan")  # one figure for all contacts
    figures = room.each_its_own(objective, room.designs_by_place(objective, slots)[0])
    return float(figures.max() if objective.worst else figures.mean())


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
