"""Compares resistances and potentials of skins with a model that is not ours.

    JAX_ENABLE_X64=1 python tests/benchmarks/skins_physics.py [--only SKIN ...]

`bench.skins.Peer` has quadratic elements on an unstructured mesh. For each skin: the
resistance between any two electrodes, by `resistances` and by the table that `points` looks
up; the table's potentials a diameter off electrodes and 3 mm off the edge, of their range,
both over the table's least disc (of the chart, as contacts are); voltages of eight
contacts. Needs triangle and shapely. Writes skins_physics.json.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from skins import sensor_of

import tomojax as tx
from bench.skins import sheets, SURFACES
from bench.skins.peer import Peer
from bench.skins.scenes import draw_contacts
from tomojax.sensor import make_field

RESULTS = Path(__file__).parents[2] / "notebooks" / "results"

# Places and weights that give a smooth function's mean over a disc, to the fifth order.
TURNS = np.pi / 3 * np.arange(6)
DISC = np.sqrt(2 / 3) * np.stack([np.cos(TURNS), np.sin(TURNS)], 1)
DISC, WEIGHTS = np.vstack([np.zeros(2), DISC]), np.array([1 / 4] + [1 / 8] * 6)


def two_point(table: np.ndarray) -> np.ndarray:
    own = np.diag(table)
    return own[:, None] + own - table - table.T


def centred(rows: np.ndarray) -> np.ndarray:
    """Without what no voltage depends on."""
    return rows - rows.mean(0) - rows.mean(1)[:, None] + rows.mean()


def worst(table: np.ndarray, right: np.ndarray, some: np.ndarray) -> float | None:
    off = np.abs(table / np.where(right == 0, 1, right) - 1)
    np.fill_diagonal(off, 0)
    return float(off[np.ix_(some, some)].max()) if some.sum() > 1 else None


def compared(d: dict) -> dict:
    # Metal discs, as those of the other model.
    sensor = replace(sensor_of(d | {"dtype": np.float64}), electrode_shunt=1.0)
    surface = SURFACES.get(d["surface"])
    peer = Peer(
        d["outline"], d["holes"], d["xy"], surface=surface, points=d.get("points", ()),
    )  # fmt: skip
    sheet = shapely.Polygon(d["outline"], d["holes"]).buffer(0)
    depth = np.array([
        sheet.boundary.distance(p) if sheet.contains(p) else 0.0
        for p in map(shapely.Point, d["xy"])
    ])  # fmt: skip
    inner, right = depth > 3e-3, peer.r_ee()
    every = np.ones_like(inner)
    field = make_field(sensor)
    tables = {
        "resistances": two_point(np.asarray(tx.sensor.resistances(sensor).electrodes)),
        "table": two_point(np.asarray(field.electrodes)),
    }
    row = {"electrodes": len(right), "divisions": sensor.divisions}
    for name, table in tables.items():
        row[f"{name}_worst"] = worst(table, right, every)
        row[f"{name}_worst_inside"] = worst(table, right, inner)
    axes = [np.linspace(0, float(s), n) for s, n in zip(field.size, field.values.shape)]
    at = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    rows = np.asarray(field.values[:, :, 0]).reshape(-1, len(right)).T
    space = surface or (lambda p: p)
    off = np.linalg.norm(space(at)[:, None] - space(d["xy"]), axis=-1).min(1)
    some = shapely.contains_xy(sheet.buffer(-3e-3), *at.T) & (off > 5e-3)
    if len(d.get("points", ())):  # an apex
        some &= np.linalg.norm(at - d["points"][0], axis=1) > 6e-3
    discs = at[some] + float(field.radii[0]) * DISC[:, None]
    reference = centred(np.tensordot(WEIGHTS, [peer.potential(d) for d in discs], 1))
    each = np.abs(centred(rows[:, some]) - reference).max(1) / np.ptp(reference)
    row["potentials_worst"] = float(each.max())
    row["potentials_worst_inside"] = float(each[inner].max()) if inner.any() else None
    pitch, rng = sensor.mean_pitch, np.random.default_rng(1)
    apart = []
    for disc in np.concatenate([draw_contacts(d, 1, rng, pitch, sheet) for _ in range(8)]):
        touch = tx.Disc.of_total(disc[:2], disc[2], disc[3])
        volts = np.asarray(tx.voltages(sensor, touch))
        apart.append(
            float(np.abs(volts - peer.voltages([disc], sensor.all_grounds())).max())
        )
    return row | {"voltages_mV": [round(1e3 * v, 2) for v in apart]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = []
    for name, d in sheets().items():
        if not options.only or name in options.only:
            rows.append({"skin": name, **compared(d)})
            print(json.dumps(rows[-1]), flush=True)
    (options.out / "skins_physics.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
