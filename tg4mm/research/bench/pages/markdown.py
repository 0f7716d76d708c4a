"""The benchmark's tables as Markdown: results, and where they come from."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tg4mm.research.bench.methods.known import METHODS
from tg4mm.research.bench.pages.tables import groups_of, kinds_tables, tables_of
from tg4mm.research.evaluate.run import STATIC
from tg4mm.research.text import TextTable, table

_FRAMING = (
    "“Nothing moves” is the Gaussians of the first of modal, paper and paper-tuned that is run, at rest; the ceiling "
    "the exact motion applied to them. "
)
_INTERVALS = (
    "After ± stands half of the 95 % interval of a mean, by bootstrap over scenes and the sets (seeds, motions) of "
    "each, with Student's t for the number of scenes. "
)
_OF_2D = "The methods called 2d magnify the test views' own videos, which no 3D method sees, and have no other views. "


def scenes_page(results: Mapping[str, Any], pictures: Mapping[str, Mapping[str, str]]) -> str:
    """Return the page that becomes docs/results.md. pictures: {group: {file name: title}}."""
    about = _listed(about_methods(results))
    left_out = f"Left out:\n\n{_listed(failures(results))}" if failures(results) else ""
    parts = ["# Results", origin(results["made"]), how(results), about, left_out]
    for group in groups_of(results):
        parts += [f"## {group}", sets_line(results, group)]
        parts += [f"![{title}]({name})" for name, title in pictures.get(group, {}).items()]
        for made in tables_of(results, group):
            parts += [f"### {made.title}", made.note, markdown(made)]
    for made in kinds_tables(results):
        parts += [f"## {made.title}", made.note, markdown(made)]
    for title, lines in remarks(results):
        parts.append(f"## {title}\n\n{_listed(lines)}")
    return "\n\n".join(part for part in parts if part) + "\n"


def _listed(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def markdown(made: TextTable) -> str:
    """Return a table as Markdown."""
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


def how(results: Mapping[str, Any]) -> str:
    """Return the notes that all tables share."""
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


def failures(results: Mapping[str, Any]) -> list[str]:
    """Return lines that name what was left out, and why."""
    lines = [f"{f['set']}{', ' if f['method'] else ''}{f['method']}: {f['why']}" for f in results["failed"]]
    return lines + [f"{line['set']}: {note}" for line in results["lines"] for note in line["notes"]]


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
    """Yield (title, lines): settings that differ from the defaults, and what an evaluation had to say."""
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
