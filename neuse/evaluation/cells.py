"""Figures of many runs as the cells of a table."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import binomtest

Figures = Mapping[str, Any]  # of a run


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def change_counts(scores: Sequence[Figures]) -> np.ndarray:
    """(3,) true, false and missed changes of all scores together."""
    return np.sum([[score[key] for key in ("tp", "fp", "fn")] for score in scores], axis=0)


def counts_cell(scores: Sequence[Figures]) -> str:
    """Changes as TP / FP / FN."""
    return " / ".join(map(str, change_counts(scores)))


def change_cells(counts: np.ndarray) -> tuple[str, str, str]:
    """(3,) counts as TP / FP / FN, precision and recall."""
    tp, fp, fn = (int(count) for count in counts)
    return f"{tp} / {fp} / {fn}", _share(tp, tp + fp), _share(tp, tp + fn)


def _share(successes: int, trials: int) -> str:
    low, high = wilson(successes, trials)
    return "-" if trials == 0 else f"{successes / trials:.3f} [{low:.3f}, {high:.3f}]"


def object_cell(runs: Sequence[Figures]) -> str:
    """Objects mapped, mapped twice, and ghosts."""
    objects = [run["objects"] for run in runs]
    mapped, true = sum(o["mapped"] for o in objects), sum(o["true"] for o in objects)
    twice, ghosts = sum(len(o["duplicates"]) for o in objects), sum(len(o["ghosts"]) for o in objects)
    return f"{mapped} / {true}, {twice} twice, {ghosts} ghosts"


def wrong_cell(runs: Sequence[Figures]) -> str:
    """Wrong loop closures of all."""
    closures = sum(run["edges"]["loop_closure"] for run in runs)
    return f"{sum(run['wrong_closures'] for run in runs)} of {closures}"


def nees_cells(parts: Sequence[dict | None]) -> tuple[str, str, str]:
    """Mean over all samples, median of the runs' medians, and how many samples."""
    known = [part for part in parts if part]
    if not known:
        return "-", "-", "0"
    n = sum(part["n"] for part in known)
    mean = sum(part["mean"] * part["n"] / part["dof"] for part in known) / n
    return f"{mean:.2f}", f"{median(part['median'] / part['dof'] for part in known):.2f}", str(n)
