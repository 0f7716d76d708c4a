"""Verdicts come from the figures: each flips when its figure crosses the goal, and says by how much it is missed."""

import copy
from typing import Any

import pytest

from tg4mm.research.bench.means import group_means
from tg4mm.research.bench.pages.markdown import judge

GROUP = "128×128, 0.2 px"


def row(modal, ceiling=0.99, still=0.9):
    values = {"nothing moves": still, "modal": modal, "ceiling": ceiling}
    return {name: {"ssim": v, "psnr_db": 30.0, "flip": 0.1, "lpips": None} for name, v in values.items()}


def run_of(label, gaps, error, leak, seconds):
    return {
        "set": label, "row": "modal", "preset": "modal", "ways": ["modal"],
        "rows": {a: row(0.99 - gap) for a, gap in gaps.items()},
        "displacement": {"relative_error": error, "static_leak": leak, "per_frequency": []},
        "seconds": {"space": seconds[0], "motion": seconds[1], "total": sum(seconds)},
        "log": {}, "n_gaussians": 9000, "mib_on_disk": 3.0,
    }  # fmt: skip


def rival_of(label, ssim, total, name="paper-tuned"):
    made = run_of(label, dict.fromkeys(ssim, 0.0), 0.9, 0.1, (total / 2, total / 2))
    rows = {a: {"linear": {"ssim": v}, "phase": {"ssim": v - 0.01}} for a, v in ssim.items()}
    return made | {"row": name, "preset": "paper-tuned", "ways": ["linear", "phase"], "rows": rows}


def results(**changes):
    gaps = {"5": 0.0005, "20": 0.0015, "50": 0.004}
    runs = [run_of("a", gaps, 0.04, 0.015, (30, 20)), run_of("b", gaps, 0.05, 0.02, (30, 25))]
    runs += [rival_of(label, {"5": 0.98, "20": 0.95, "50": 0.92}, 60.0) for label in ("a", "b")]
    sets = [{"label": label, "group": GROUP, "amplitude_px": 0.22} for label in ("a", "b")]
    found: dict[str, Any] = {"sets": sets, "runs": runs}
    found.update(changes)
    found["means"] = group_means(found["runs"], {s["label"]: s["group"] for s in found["sets"]})
    return found


def verdict(found, part):
    (one,) = [v for v in judge(found) if part in v["goal"]]
    return one


def changed(index, path, value):
    runs = copy.deepcopy(results()["runs"])
    target = runs[index]
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    return results(runs=runs)


def test_all_are_reached_by_figures_at_or_inside_the_goals():
    assert {v["goal"]: v["reached"] for v in judge(results())} == {
        "SSIM within 0.002 of the ceiling at α ≤ 20": True,
        "SSIM within 0.005 of the ceiling at α = 50": True,
        "displacement error ≤ 5% at 0.2 px": True,
        "static leak ≤ 2%": True,
        "the motion stage is faster than the space stage": True,
        "modal beats paper-tuned at every α on every scene, given the same time": True,
    }


@pytest.mark.parametrize(
    ("path", "value", "part", "shortfall"),
    [
        (["rows", "20", "modal", "ssim"], 0.99 - 0.0045, "α ≤ 20", "0.0030 at α = 20, missed by 0.0010"),
        (["rows", "50", "modal", "ssim"], 0.99 - 0.012, "α = 50", "0.0080 at α = 50, missed by 0.0030"),
        (["displacement", "relative_error"], 0.11, "displacement error", "8.0%, missed by 3.0%"),
        (["displacement", "static_leak"], 0.05, "static leak", "3.50%, missed by 1.50%"),
        (["seconds"], {"space": 30, "motion": 60, "total": 90}, "motion stage", "slower on 1 of 2: a"),
    ],
)
def test_a_mean_beyond_the_goal_misses_it(path, value, part, shortfall):
    before, after = verdict(results(), part), verdict(changed(0, path, value), part)
    assert (before["reached"], after["reached"]) == (True, False)
    assert shortfall in after["detail"]


@pytest.mark.parametrize("method", ["linear", "phase"])
def test_one_alpha_of_one_scene_is_enough_to_lose_to_the_rival(method):
    after = verdict(changed(3, ["rows", "20", method, "ssim"], 0.9985), "beats")
    assert after["reached"] is False
    assert after["detail"] == "missed in 1 of 6: b at α = 20 by 0.0100"


def test_a_rival_that_had_less_time_proves_nothing():
    short = changed(2, ["seconds", "total"], 10.0)
    assert verdict(short, "beats")["reached"] is None
    assert "had less time than modal on a" in verdict(short, "beats")["detail"]
    again = rival_of("a", {"5": 0.981, "20": 0.951, "50": 0.921}, 50.0, "paper-tuned, modal's time")
    assert verdict(results(runs=[*short["runs"], again]), "beats")["reached"] is True


def test_what_was_not_measured_is_not_judged():
    no_alpha = results(runs=[run_of(x, {"5": 0.0}, 0.04, 0.01, (3, 2)) for x in ("a", "b")])
    assert verdict(no_alpha, "α = 50")["reached"] is None
    assert verdict(no_alpha, "beats")["reached"] is None
    without = changed(0, ["displacement"], None)  # which the other method has of both sets
    assert verdict(without, "leak")["reached"] is None
    of_no_row = [run | ({"displacement": None} if run["set"] == "a" else {}) for run in results()["runs"]]
    assert verdict(results(runs=of_no_row), "leak")["reached"] is True  # of the set that has it
