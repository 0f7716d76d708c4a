"""The benchmark's tables as Markdown: results, where they come from, goals."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tg4mm.research.bench.means import JUDGED
from tg4mm.research.bench.methods.known import METHODS
from tg4mm.research.bench.pages.tables import groups_of, kinds_tables, tables_of
from tg4mm.research.bench.sets import goal_amplitude
from tg4mm.research.evaluate.run import STATIC
from tg4mm.research.text import Table, table


def scenes_page(results: Mapping[str, Any], pictures: Mapping[str, Mapping[str, str]]) -> str:
    """What becomes docs/results.md. pictures: {group: {file name: title}}."""
    about = "\n".join(f"- {line}" for line in about_methods(results))
    parts = ["# Results", origin(results["made"]), how(results), about, failures(results)]
    for group in groups_of(results):
        parts += [f"## {group}", sets_line(results, group)]
        parts += [f"![{title}]({name})" for name, title in pictures.get(group, {}).items()]
        for made in tables_of(results, group):
            parts += [f"### {made.title}", made.note, markdown(made)]
    for made in kinds_tables(results):
        parts += [f"## {made.title}", made.note, markdown(made)]
    for title, lines in remarks(results):
        parts.append("\n".join([f"## {title}\n", *(f"- {line}" for line in lines)]))
    return "\n\n".join(part for part in parts if part) + "\n"


def markdown(made: Table) -> str:
    return table(made.header, made.rows, made.text_columns)


def origin(made: Mapping[str, Any]) -> str:
    """The command, the machine, the day and the version, as a code block and a sentence."""
    return f"    {made['command']}\n\n{machine(made)} Seconds depend on all of these."


def machine(made: Mapping[str, Any]) -> str:
    """The day, the version and the machine in one sentence."""
    load = "" if made["load_average"] is None else f", load average {made['load_average']:g} at the start"
    return f"{made['date']}, {_computer(made)}{load}."


def _computer(made: Mapping[str, Any]) -> str:
    cores, threads = (f"{made[f'{w}s']} {w}{'s' * (made[f'{w}s'] != 1)}" for w in ("core", "thread"))
    return (
        f"tg4mm {made['tg4mm']}, Python {made['python']}, torch {made['torch']}; {made['system']}, "
        f"{made['processor']}, {cores}, {threads}"
    )


def trained_otherwise(made: Mapping[str, Any], runs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Lines on the runs {name: …} that were trained by other code or on another machine than the page was `made` by."""
    found: dict[str, list[str]] = {}
    for name, run in runs.items():
        if run.get("made") and _computer(run["made"]) != _computer(made):
            found.setdefault(_computer(run["made"]), []).append(f"{name} ({run['made']['date']})")
    return [f"{computer}: {', '.join(names)}" for computer, names in found.items()]


_FRAMING = (
    "“Nothing moves” is the Gaussians of the first of modal, paper and paper-tuned that is run, at rest; the ceiling "
    "the exact motion applied to them. "
)
_INTERVALS = (
    "After ± stands half of the 95 % interval of a mean, by bootstrap over scenes and the sets (seeds, motions) of "
    "each, with Student's t for the number of scenes. "
)
_OF_2D = "The methods called 2d magnify the test views' own videos, which no 3D method sees, and have no other views. "


def how(results: Mapping[str, Any]) -> str:
    """What all tables share."""
    own = [name for name in results["methods"] if name in METHODS]  # not what an outside method may be called
    band = (
        f"Every method magnifies the same band: {results['band']}. "
        if results["band"]
        else "Every method magnifies all frequencies. "
    )
    return (
        "α is the magnification factor: a displacement δ is shown as (1 + α) δ. "
        + band
        + "All methods are scored from their pictures of the test views at 8 bits (docs/protocol.md). "
        + (_INTERVALS if any(m["n_sets"] > 1 for m in results["line_means"]) else "")
        + (_FRAMING if any(line["row"] == STATIC for line in results["lines"]) else "")
        + (_OF_2D if any(name.endswith("-2d") for name in own) else "")
        + (_time_rule(results) if any(name.startswith("paper") for name in own) else "")
    ).rstrip()


def about_methods(results: Mapping[str, Any]) -> list[str]:
    """A line for each method."""
    return [
        f"`{name}`: {METHODS[name].about if name in METHODS else 'pictures made elsewhere, by --external'}."
        for name in results["methods"]
    ]


def _time_rule(results: Mapping[str, Any]) -> str:
    rule = {
        "needed": "A preset of the paper that took less time than modal is trained once more",
        "always": "Every preset of the paper is trained once more",
        "never": "Training times are not matched between presets",
    }[results["same_time"]]
    if results["same_time"] == "never":
        return rule + "."
    return (
        rule
        + " with all its iterations scaled by the ratio of the two training times just measured (the row "
        "“modal's time”); the resulting settings stand below and repeat it anywhere. One that took longer than modal "
        "had the advantage already. Times are of training, without rendering."
    )


def failures(results: Mapping[str, Any]) -> str:
    """What was left out, and why; empty where nothing was."""
    lines = [f"- {f['set']}{', ' if f['method'] else ''}{f['method']}: {f['why']}" for f in results["failed"]]
    lines += [f"- {line['set']}: {note}" for line in results["lines"] for note in line["notes"]]
    return "Left out:\n\n" + "\n".join(lines) if lines else ""


def sets_line(results: Mapping[str, Any], group: str) -> str:
    """The sets of a group, each with its size."""
    each = (
        f"{s['label']} ({s['n_views']} views × {s['n_timesteps']} timesteps, {s['frequency_hz']:g} Hz, "
        f"{s['amplitude_px']:.2g} px)"
        for s in results["sets"]
        if s["group"] == group
    )
    return (
        "Sets: " + "; ".join(each) + ". Amplitudes are the largest displacement in the first training camera."
    )


def remarks(results: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """(title, lines): settings that differ from the defaults, and what an evaluation had to say."""
    given = {
        (run["row"], run["set"]): " ".join(f"--set {k}={v}" for k, v in run["overrides"].items())
        for run in results["runs"]
        if run["overrides"]
    }
    if given:
        lines = [f"{row}, {label}: `{text}`" for (row, label), text in given.items()]
        yield "Settings other than the defaults", lines
    runs = {f"{run['row']} on {run['set']}": run for run in results["runs"]}
    if lines := trained_otherwise(results["made"], runs):
        yield "Trained by other code or elsewhere", lines
    notes: dict[str, list[str]] = {}
    for run in results["runs"]:
        missing = [f"not measured: {what}: {why}" for what, why in run["absent"].items()]
        for note in [*run["notes"], *missing]:
            if run["set"] not in notes.setdefault(note, []):
                notes[note].append(run["set"])
    if notes:
        yield "Notes", [f"{', '.join(labels)}: {note}" for note, labels in notes.items()]


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
