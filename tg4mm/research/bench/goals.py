"""The project's goals, judged by a benchmark's figures: reached, or missed and by how much."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tg4mm.research.bench.pages.markdown import origin
from tg4mm.research.bench.sets import goal_amplitude
from tg4mm.research.text import table

JUDGED = "modal"  # the preset that the goals are for
RIVAL = "paper-tuned"
_GAPS = ((20.0, 0.002), (50.0, 0.005))  # α up to which, SSIM below the ceiling at most
_ERRORS = {0.2: 0.05, 0.02: 0.10}  # displacement error at an amplitude in pixels
_LEAK = 0.02
_ENOUGH_TIME = 0.98  # of modal's seconds: a rival that had that much had the same time


_VERDICTS = {True: "reached", False: "**missed**", None: "not judged"}


@dataclass(frozen=True)
class Verdict:
    """A goal for one group of sets."""

    goal: str
    group: str
    reached: bool | None  # None: the figures that it needs are not there
    detail: str  # the figure, and how far it is from the goal

    def plain(self) -> dict[str, Any]:
        return {"goal": self.goal, "group": self.group, "reached": self.reached, "detail": self.detail}


def judge(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All goals for each group of sets, from `sets`, `runs` and `means` of results.json."""
    verdicts: list[Verdict] = []
    for means in results["means"]:
        if means["row"] != JUDGED:
            continue
        pixels = [s["amplitude_px"] for s in results["sets"] if s["label"] in means["sets"]]
        verdicts += _of_group(means, goal_amplitude(pixels[0]))
        verdicts.append(_stage_times(means, results["runs"]))
        verdicts.append(_against_rival(means, results["runs"]))
    return [v.plain() for v in verdicts]


def goals_page(results: Mapping[str, Any]) -> str:
    """The verdicts in Markdown."""
    rows = [[g["goal"], g["group"], _VERDICTS[g["reached"]], g["detail"]] for g in judge(results)]
    listed = (
        table(["goal (means over scenes)", "sets", "", "figure"], rows, text_columns=4)
        if rows
        else f"The preset `{JUDGED}`, which the goals are for, was not run."
    )
    return "\n\n".join(["# Goals", origin(results["made"]), listed]) + "\n"


def _of_group(means: Mapping[str, Any], amplitude: float | None) -> Iterator[Verdict]:
    """The goals for means over scenes."""
    group, figures = means["group"], means["scalars"]
    low = 0.0
    for high, most in _GAPS:
        at = f"α ≤ {high:g}" if low == 0.0 else f"α = {high:g}"
        name = f"SSIM within {most:g} of the ceiling at {at}"
        gaps = {float(a): g["modal"] for a, g in means["gaps"].items() if low < float(a) <= high}
        gaps = {a: g for a, g in gaps.items() if g is not None and (low == 0.0 or a == high)}
        if not gaps:
            yield Verdict(name, group, None, f"no ground truth at {at}")
        else:
            worst = max(gaps, key=lambda a: gaps[a])
            yield _at_most(name, group, gaps[worst], most, "{:.4f}", f" at α = {worst:g}")
        low = high
    if amplitude in _ERRORS:
        most = _ERRORS[amplitude]
        name = f"displacement error ≤ {most:.0%} at {amplitude:g} px"
        yield _at_most(name, group, figures["displacement_error"], most, "{:.1%}")
    yield _at_most(f"static leak ≤ {_LEAK:.0%}", group, figures["static_leak"], _LEAK, "{:.2%}")


def _at_most(name: str, group: str, value: float | None, most: float, form: str, where: str = "") -> Verdict:
    if value is None:
        return Verdict(name, group, None, "not measured")
    text = form.format(value) + where
    if value <= most:
        return Verdict(name, group, True, text)
    return Verdict(name, group, False, f"{text}, missed by {form.format(value - most)}")


def _stage_times(means: Mapping[str, Any], runs: list[Mapping[str, Any]]) -> Verdict:
    """Motion stage against space stage, as sums over the sets, so that each counts by its seconds."""
    mine = [r for r in runs if r["row"] == JUDGED and r["set"] in means["sets"]]
    space, motion = (sum(r["seconds"][stage] for r in mine) for stage in ("space", "motion"))
    slower = [r["set"] for r in mine if r["seconds"]["motion"] >= r["seconds"]["space"]]
    name = "the motion stage is faster than the space stage"
    detail = f"{motion / len(mine):.0f} s to {space / len(mine):.0f} s a set"
    if slower:
        detail += f"; slower on {len(slower)} of {len(mine)}: {', '.join(slower)}"
    if motion >= space:
        detail += f"; missed by a factor of {motion / space:.2f}" if space else "; no space stage"
    return Verdict(name, means["group"], motion < space, detail)


def _against_rival(means: Mapping[str, Any], runs: list[Mapping[str, Any]]) -> Verdict:
    """`modal` above every row of the rival, by either of its methods, at every α on every set."""
    name = f"modal beats {RIVAL} at every α on every scene, given the same time"
    compared, lost, short, margin = 0, [], [], float("inf")
    for mine in (r for r in runs if r["row"] == JUDGED and r["set"] in means["sets"]):
        rivals = [r for r in runs if r["preset"] == RIVAL and r["set"] == mine["set"]]
        if not rivals:
            return Verdict(name, means["group"], None, f"{RIVAL} was not run on {mine['set']}")
        enough = _ENOUGH_TIME * mine["seconds"]["total"]
        if all(r["seconds"]["total"] < enough for r in rivals):
            short.append(mine["set"])
        for alpha, row in mine["rows"].items():
            ours, best = _ssim(row, "modal"), _best(rivals, alpha)
            if float(alpha) == 0.0 or ours is None or best is None:
                continue
            compared += 1
            margin = min(margin, ours - best)
            if ours <= best:
                lost.append(f"{mine['set']} at α = {alpha} by {best - ours:.4f}")
    if short:
        return Verdict(name, means["group"], None, f"{RIVAL} had less time than modal on {', '.join(short)}")
    if not compared:
        return Verdict(name, means["group"], None, "no α with ground truth")
    if lost:
        return Verdict(name, means["group"], False, f"missed in {len(lost)} of {compared}: {'; '.join(lost)}")
    return Verdict(name, means["group"], True, f"in all {compared}, by {margin:.4f} SSIM or more")


def _best(rivals: list[Mapping[str, Any]], alpha: str) -> float | None:
    values = [_ssim(r["rows"].get(alpha, {}), way) for r in rivals for way in r["ways"]]
    return max((v for v in values if v is not None), default=None)


def _ssim(row: Mapping[str, Mapping[str, Any]], method: str) -> float | None:
    return row.get(method, {}).get("ssim")
