"""Sets Table I beside the paper's numbers: rows, summary and sensitivity of a `Study`."""

from typing import Any

import numpy as np

from tomojax.paper.table1._study import ADAPTIVE, PAPER, Study

F_SWITCH = 10e3  # Hz
_MARGINS = (0.010, 0.020, 0.030, 0.040, 0.050, 0.060)  # m from the edge, of `sensitivity`


def rows(study: Study) -> list[dict[str, Any]]:
    """Returns a row per pattern, units in the keys; spreads are standard deviations."""
    inside = study.inside()
    width_of_all = study.own["all"]["half_width"][inside, -1].mean()
    table = []
    for name, (paper_width, paper_dt) in PAPER.items():
        own, exact = study.own[name], study.exact[name]
        widths, error = own["half_width"][inside, -1], own["place_error"][inside, -1]
        slots = study.grounds[name].shape[-1]
        dt = 1e3 * slots / F_SWITCH
        table.append(
            {
                "pattern": name,
                "slots": slots,
                "dt_ms": dt,
                # Two exploratory slots, which the paper's Table I leaves out.
                "dt_explored_ms": dt + (2e3 / F_SWITCH if name in ADAPTIVE else 0.0),
                "width_mm": float(widths.mean()),
                "width_spread_mm": float(widths.std()),
                "width_ratio": float(widths.mean() / width_of_all),
                "paper_width_mm": paper_width,
                "paper_width_ratio": paper_width / PAPER["all"][0],
                "paper_dt_ms": paper_dt,
                "place_error_mm": float(np.median(error)),
                "place_error_p90_mm": float(np.percentile(error, 90)),
                "exact_width_mm": float(exact["half_width"].mean()),
                "exact_place_error_mm": float(np.median(exact["place_error"])),
                "exact_place_error_p90_mm": float(np.percentile(exact["place_error"], 90)),
            }
        )
    return table


def summary(study: Study) -> dict[str, Any]:
    """Returns the two figures of how well Table I is predicted, and what was averaged."""
    told = rows(study)
    return {
        **agreement(study, study.inside()),
        "temporal_column_exact": all(
            abs(row["dt_ms"] - row["paper_dt_ms"]) < 1e-9 for row in told
        ),
        "lam": float(study.lams[-1]),
        "contacts": int(study.inside().sum()),
        "width": "half the width at half the maximum, mean of +x, -x, +y, -y",
        "place": "centre of what exceeds half the maximum; median over contacts",
        "exact": "10 mm discs of 2 S/m2 by the exact contact model, 64 x 64 cells, 0.3 mV "
        "of noise, 16 bits",
        "sensitivity": sensitivity(study),
    }


def agreement(
    study: Study, kept: np.ndarray, at: int = -1, figure: str = "half_width"
) -> dict[str, float]:
    """Returns the rank correlation of the widths, and the rms error of their ratios.

    The correlation is Spearman's, of the nine widths. The error is relative, of the eight
    ratios to *All*. Both are against the paper's widths.
    """
    ours = np.array([study.own[name][figure][kept, at].mean() for name in PAPER])
    paper = np.array([width for width, _ in PAPER.values()])
    # The paper's widths have no ties, nor have means of floats: ranks are sort orders.
    ranks = np.corrcoef(ours.argsort().argsort(), paper.argsort().argsort())[0, 1]
    relative = (ours / ours[0])[1:] / (paper / paper[0])[1:] - 1
    return {
        "width_rank_correlation": float(ranks),
        "width_ratio_rms_relative_error": float(np.sqrt(np.mean(relative**2))),
    }


def sensitivity(study: Study) -> list[dict[str, Any]]:
    """Returns `agreement` for every margin from the edge, λ and definition of width."""
    found = []
    for margin in _MARGINS:
        kept = study.inside(margin)
        for figure in ("half_width", "half_area_radius"):
            for at, lam in enumerate(study.lams):
                width = study.own["all"][figure][kept, at].mean()
                told = {"margin_mm": 1e3 * margin, "width": figure, "lam": float(lam)}
                told |= {"all_width_mm": float(width), "contacts": int(kept.sum())}
                found.append(told | agreement(study, kept, at, figure))
    return found


def score(dt: np.ndarray, width: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Returns Fig. 4's weighted score (weights, patterns).

    The score is w·width_min/width + (1 − w)·Δt_min/Δt. 1 is the best in everything that the
    weight counts. The paper gives the figure, not its formula; this is our reading.
    """
    w = weight[:, None]
    return w * width.min() / width + (1 - w) * dt.min() / dt


_HEAD = (
    "              slots   dt, ms  | width, mm  ratio | the paper's   ratio   dt "
    "| place, mm | exact: width  place"
)
_LINE = (
    "{pattern:12s} {slots:6d} {dt_ms:8.2f}  | {width_mm:5.1f} ±{width_spread_mm:4.1f} "
    "{width_ratio:5.2f} | {paper_width_mm:8.1f} {paper_width_ratio:9.2f} "
    "{paper_dt_ms:6.2f} | {place_error_mm:9.1f} | {exact_width_mm:9.1f} "
    "{exact_place_error_mm:9.1f}"
)


def text(study: Study) -> str:
    """Returns the table as it is printed."""
    told = summary(study)
    rank, error = told["width_rank_correlation"], told["width_ratio_rms_relative_error"]
    return "\n".join(
        [
            _HEAD,
            *(_LINE.format(**row) for row in rows(study)),
            "ratios of widths against the paper's: rank correlation "
            f"{rank:.2f}, rms relative error {100 * error:.1f} %",
            f"one λ = {told['lam']:.3g} for all, from the width of 'all' alone; means over "
            f"{told['contacts']} contacts, place: medians",
        ]
    )
