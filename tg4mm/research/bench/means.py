"""Means over scenes, for sets of one size, amplitude and kind of capture, or only of one kind of capture."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from tg4mm.research.bench.measure import stage_costs

# 95 % intervals by bootstrap: scenes are drawn with replacement, then of each drawn scene its sets, since sets of one
# scene are alike. Half the interval is the standard deviation of the resampled means times √(n / (n − 1)) t, with t
# Student's quantile for the n scenes: with the bare quantiles of so few it would be too short (Hesterberg, The American
# Statistician 69, 2015).
_RESAMPLES = 4000
_LEVEL = 0.95
JUDGED = "modal"  # the row that others are compared with


def half_width(values: Sequence[float], scenes: Sequence[str]) -> float | None:
    """Return half of the 95 % interval of the mean of `values` [N] of `scenes`; None for a single value.

    For one scene its sets are drawn, so that the interval excludes the scatter of scenes.
    """
    if len(values) < 2:
        return None
    names = {name: i for i, name in enumerate(dict.fromkeys(scenes))}
    weights, factor = _drawn(tuple(names[scene] for scene in scenes))
    return float(factor * np.std(weights @ np.asarray(values, np.float64)))


@lru_cache(maxsize=64)
def _drawn(scene_of: tuple[int, ...]) -> tuple[np.ndarray, float]:
    """Return the values' weights in each resampled mean [resamples, N], and half an interval over its deviation."""
    from scipy.stats import t

    rng = np.random.default_rng(0)
    found = np.asarray(scene_of if max(scene_of) else range(len(scene_of)))
    n = int(found.max()) + 1
    members = [np.flatnonzero(found == i) for i in range(n)]
    counts = np.zeros((_RESAMPLES, len(found)))
    rows = np.arange(_RESAMPLES)
    for chosen in rng.integers(n, size=(n, _RESAMPLES)):
        for i, mine in enumerate(members):
            drawn = rows[chosen == i]
            picks = mine[rng.integers(len(mine), size=(len(drawn), len(mine)))]
            np.add.at(counts, (drawn[:, None], picks), 1)
    factor = math.sqrt(n / (n - 1)) * float(t.ppf(0.5 + _LEVEL / 2, n - 1))
    return counts / counts.sum(1, keepdims=True), factor


def main_frequency(displacement: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the entry of `displacement_figures` for the strongest frequency; {} without one."""
    rows = (displacement or {}).get("per_frequency") or []
    return max(rows, key=lambda row: row["amplitude_true"] or 0.0, default={})


def scalars(run: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the figures of a run that do not depend on α: seconds, degrees, MiB of each stage."""
    moved = run["displacement"] or {}
    main = main_frequency(moved)
    seconds, observed = run["seconds"], run.get("observed") or {}
    return {
        "displacement_error": moved.get("relative_error"),
        "displacement_error_observed": observed.get("displacement_error_observed"),
        "observed_share": observed.get("observed_share"),
        "static_leak": moved.get("static_leak"),
        "amplitude_ratio": main.get("amplitude_ratio"),
        "direction_error_deg": main.get("direction_error_deg"),
        "phase_error_deg": main.get("phase_error_deg"),
        "mac": main.get("mac"),
        "frequency_error_hz": _apart(run.get("strongest_hz"), main.get("frequency_hz")),
        "space_s": seconds["space"],
        "motion_s": seconds["motion"],
        "total_s": seconds["total"],
        **stage_costs(run["log"]),
        "n_gaussians": run["n_gaussians"],
        "mib_on_disk": run["mib_on_disk"],
    }


def _apart(found: float | None, true: float | None) -> float | None:
    return None if found is None or true is None else abs(found - true)


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of known values; None without any."""
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None


def mean_of_all(values: Iterable[float | None]) -> float | None:
    """Return the mean; None if a value is missing."""
    known = list(values)
    return None if None in known else mean(known)


def half_of(values: Iterable[tuple[str, float | None]], scene_of: Mapping[str, str]) -> float | None:
    """Return half of the 95 % interval of the mean over (set, value); None for a missing value, or one set."""
    sets, known = zip(*values, strict=True) if (values := list(values)) else ((), ())
    return None if None in known else half_width(known, [scene_of.get(label, label) for label in sets])


def group_means(
    runs: Iterable[Mapping[str, Any]],
    group_of: Mapping[str, str],
    scene_of: Mapping[str, str] = MappingProxyType({}),
) -> list[dict[str, Any]]:
    """Return means of `scalars` as [{group, row, n_sets, sets, scalars: {…}, half: {scalar: …}}], like `line_means`."""
    lines = [{**run, "alphas": {"": scalars(run)}, "frames_per_s": None} for run in runs]
    return [
        {
            **{key: m[key] for key in ("group", "row", "n_sets", "sets")},
            "scalars": m["alphas"][""],
            "half": m["half"][""],
        }
        for m in line_means(lines, group_of, scene_of)
    ]


def line_means(
    lines: Iterable[Mapping[str, Any]],
    group_of: Mapping[str, str],
    scene_of: Mapping[str, str] = MappingProxyType({}),
) -> list[dict[str, Any]]:
    """Return means of scores as [{group, row, n_sets, sets, alphas, half: {α: {metric}}, frames_per_s}].

    `group_of`, `scene_of`: by a set's label; half: of the 95 % interval of each mean. An α counts only if every set of
    the group with this row has ground truth for it, so that a line only has means of the same scenes. For the same
    reason a metric that a set has in no row (such as without motion) is the mean of the other sets in every row, and a
    metric that only this row lacks in a set is None.
    """
    lines, grouped = list(lines), dict[tuple[str, str], list[Mapping[str, Any]]]()
    for line in lines:
        grouped.setdefault((group_of[line["set"]], line["row"]), []).append(line)
    scored = {
        (line["set"], alpha, metric)
        for line in lines
        for alpha, scores in line["alphas"].items()
        for metric, value in scores.items()
        if value is not None
    }
    found = []
    for (group, row), mine in grouped.items():
        common = [a for a in mine[0]["alphas"] if all(a in line["alphas"] for line in mine)]
        metrics = dict.fromkeys(k for line in mine for scores in line["alphas"].values() for k in scores)
        values = {
            a: {
                k: [(x["set"], x["alphas"][a].get(k)) for x in mine if (x["set"], a, k) in scored]
                for k in metrics
            }
            for a in common
        }
        means = {
            a: {k: mean_of_all(v for _, v in some) for k, some in of.items()} for a, of in values.items()
        }
        halves = {a: {k: half_of(some, scene_of) for k, some in of.items()} for a, of in values.items()}
        speed = mean(line["frames_per_s"] for line in mine)
        sets = [line["set"] for line in mine]
        found.append(
            {"group": group, "row": row, "n_sets": len(mine), "sets": sets, "alphas": means, "half": halves}
            | {"frames_per_s": speed}
        )
    return found


def less(lines: Iterable[Mapping[str, Any]], base: str) -> list[dict[str, Any]]:
    """Return the other lines with every score less that of the row `base` on the same set at the same α."""
    lines = list(lines)
    of_base = {line["set"]: line["alphas"] for line in lines if line["row"] == base}
    found = []
    for line in lines:
        if line["row"] == base or line["set"] not in of_base:
            continue
        beside = of_base[line["set"]]
        alphas = {
            a: {k: _less(v, beside[a].get(k)) for k, v in scores.items()}
            for a, scores in line["alphas"].items()
            if a in beside
        }
        found.append({**line, "alphas": alphas})
    return found


def _less(value: float | None, other: float | None) -> float | None:
    return None if value is None or other is None else value - other
