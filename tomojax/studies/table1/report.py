"""Sets Table I beside the paper's numbers: rows, summary and sensitivity of a `Study`."""

from typing import Any

import numpy as np

from tomojax.studies.table1._study import F_SWITCH, MARGINS, Measured, PAPER, Study

_ADAPTIVE = ("around", "cop_line", "point")


def rows(study: Study) -> list[dict[str, Any]]:
    """Returns a row per pattern, units in the keys; spreads are standard deviations."""
    inside = study.inside
    width_of_all = _mm(study.own["all"].half_width)[inside, -1].mean()
    table = []
    for name, (paper_width, paper_dt) in PAPER.items():
        own, exact = study.own[name], study.exact[name]
        widths = _mm(own.half_width)[inside, -1]
        error, exact_error = _mm(own.place_error)[inside, -1], _mm(exact.place_error)[:, 0]
        slots = study.patterns[name].shape[-1]
        dt = 1e3 * slots / F_SWITCH
        table.append(
            {
                "pattern": name,
                "slots": slots,
                "dt_ms": dt,
                # Two exploratory slots, which the paper's Table I leaves out.
                "dt_explored_ms": dt + (2e3 / F_SWITCH if name in _ADAPTIVE else 0.0),
                "width_mm": float(widths.mean()),
                "width_spread_mm": float(widths.std()),
                "width_ratio": float(widths.mean() / width_of_all),
                "paper_width_mm": paper_width,
                "paper_width_ratio": paper_width / PAPER["all"][0],
                "paper_dt_ms": paper_dt,
                "place_error_mm": float(np.median(error)),
                "place_error_p90_mm": float(np.percentile(error, 90)),
                "exact_width_mm": float(_mm(exact.half_width).mean()),
                "exact_place_error_mm": float(np.median(exact_error)),
                "exact_place_error_p90_mm": float(np.percentile(exact_error, 90)),
            }
        )
    return table


def summary(study: Study) -> dict[str, Any]:
    """Returns the two figures of how well Table I is predicted, and what was averaged."""
    rank, error = agreement(study.own, study.inside, -1)
    dt = {r["pattern"]: (r["dt_ms"], r["paper_dt_ms"]) for r in rows(study)}
    return {
        "width_rank_correlation": rank,
        "width_ratio_rms_relative_error": error,
        "temporal_column_exact": all(abs(a - b) < 1e-9 for a, b in dt.values()),
        "lam": study.lam,
        "contacts": int(study.inside.sum()),
        "width": "half the width at half the maximum, mean of +x, -x, +y, -y",
        "place": "centre of what exceeds half the maximum; median over contacts",
        "exact": "10 mm discs of 2 S/m2 by the exact contact model, 64 x 64 cells, 0.3 mV "
        "of noise, 16 bits",
        "sensitivity": sensitivity(study),
    }


def agreement(
    own: dict[str, Measured], inside: np.ndarray, at: int, figure: str = "half_width"
) -> tuple[float, float]:
    """Returns the rank correlation of the widths, and the rms error of their ratios.

    The correlation is Spearman's, of the nine widths. The error is relative, of the eight
    ratios to *All*. Both are against the paper's widths.
    """
    mean = {name: getattr(own[name], figure)[inside, at].mean() for name in PAPER}
    ours = np.array([float(mean[name] / mean["all"]) for name in PAPER])
    paper = np.array([width / PAPER["all"][0] for width, _ in PAPER.values()])
    # The paper's widths have no ties, nor have means of floats: ranks are sort orders.
    ranks = np.corrcoef(ours.argsort().argsort(), paper.argsort().argsort())[0, 1]
    relative = ours[1:] / paper[1:] - 1
    return float(ranks), float(np.sqrt(np.mean(relative**2)))


def sensitivity(study: Study) -> list[dict[str, Any]]:
    """Returns `agreement` for every margin from the edge, λ and definition of width."""
    size = study.size
    found = []
    for margin in MARGINS:
        kept = ((study.places >= margin) & (study.places <= size - margin)).all(1)
        kept = np.asarray(kept)
        for figure in ("half_width", "half_area_radius"):
            for at, lam in enumerate([*study.sweep, study.lam]):
                rank, error = agreement(study.own, kept, at, figure)
                width = _mm(getattr(study.own["all"], figure))[kept, at].mean()
                found.append(
                    {
                        "margin_mm": 1e3 * margin,
                        "width": figure,
                        "lam": float(lam),
                        "all_width_mm": float(width),
                        "contacts": int(kept.sum()),
                        "width_rank_correlation": rank,
                        "width_ratio_rms_relative_error": error,
                    }
                )
    return found


def score(dt: np.ndarray, width: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Returns Fig. 4's weighted score (weights, patterns).

    The score is w·width_min/width + (1 − w)·Δt_min/Δt. 1 is the best in everything that the
    weight counts. The paper gives the figure, not its formula; this is our reading.
    """
    w = weight[:, None]
    return w * width.min() / width + (1 - w) * dt.min() / dt


def text(study: Study) -> str:
    """Returns the table as it is printed."""
    lines = [
        "              slots   dt, ms  | width, mm  ratio | the paper's   ratio   dt "
        "| place, mm | exact: width  place",
    ]
    for r in rows(study):
        lines.append(
            f"{r['pattern']:12s} {r['slots']:6d} {r['dt_ms']:8.2f}  | "
            f"{r['width_mm']:5.1f} ±{r['width_spread_mm']:4.1f} {r['width_ratio']:5.2f} | "
            f"{r['paper_width_mm']:8.1f} {r['paper_width_ratio']:9.2f} "
            f"{r['paper_dt_ms']:6.2f} | {r['place_error_mm']:9.1f} | "
            f"{r['exact_width_mm']:9.1f} {r['exact_place_error_mm']:9.1f}"
        )
    s = summary(study)
    lines.append(
        f"ratios of widths against the paper's: rank correlation "
        f"{s['width_rank_correlation']:.2f}, rms relative error "
        f"{100 * s['width_ratio_rms_relative_error']:.1f} %"
    )
    lines.append(
        f"one λ = {study.lam:.3g} for all, from the width of 'all' alone; means over "
        f"{s['contacts']} contacts, place: medians"
    )
    return "\n".join(lines)


def _mm(values: Any) -> np.ndarray:
    return 1e3 * np.asarray(values, np.float64)
