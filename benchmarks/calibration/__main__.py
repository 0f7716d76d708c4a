"""Are the printed errors true, and how small a motion is found? Random films with exact truth, and one table.

    python -m benchmarks.calibration DIR [--films 60] [--first 0] [--jobs 2] [--stages look whole baselines]
                                         [--python FILE]
    python -m benchmarks.calibration DIR --kinds [--films 12]
    python -m benchmarks.calibration DIR --plain|--large|--real [--films 60]
    python -m benchmarks.calibration DIR --duplicates [--photographs FOLDER] [--films 600]

Films (`draw.py`), what each stage says of them and their scores go to DIR; what is there is kept, and a stopped call
goes on. Stages: `look` is one pass over the video (`tg4mm.capture.look`); `whole` is sfm, train and measure with a
sensor on every true vibration; `baselines` are pyidi's Lucas-Kanade and a phase-based estimator on the same regions
(--python: one that has pyidi). Each stage has its own table: how many errors lie within 1 and 2 of their ±, false
lines, and how many of the vibrations are named by amplitude. With --kinds instead of films: small sets of our
generator (`kinds.py`), a tripod, a camera in a hand, a rig and clips in turn, through train and measure.
With --plain: films on which nothing vibrates, whose wall has hardly any texture ; with --large: plates of
which one or two move by .8 to 4 px (`special.py`); with --real: films made of photographs, each at four qualities
(`photographs.py`). With --duplicates: small films, half of them with duplicate frames (`duplicates.py`).
"""

import argparse
import json
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.__main__ import add
from benchmarks.calibration import stages
from benchmarks.calibration.draw import FilmTruth, make_film
from benchmarks.calibration.duplicates import duplicates_outcome, duplicates_table
from benchmarks.calibration.kinds import kinds_stage
from benchmarks.calibration.photographs import make_photograph_film
from benchmarks.calibration.score import Score, compared, table
from benchmarks.calibration.special import make_large_film, make_plain_film

Maker = Callable[[int, Path], FilmTruth]
OPTIONS: dict[str, Any] = {"folder": Path, "--films": 60, "--first": 0, "--jobs": 2}
OPTIONS |= {"--python": sys.executable, "--photographs": Path}
OPTIONS |= dict.fromkeys(("--kinds", "--plain", "--large", "--real", "--duplicates"), False)
STAGES: dict[str, Callable[..., dict[str, Score]]] = {
    "look": stages.look_stage,
    "whole": stages.whole_stage,
    "baselines": stages.baselines_stage,
}
OPTIONS["--stages"] = {"nargs": "+", "choices": list(STAGES), "default": ["look"]}


def scored(
    seed: int, folder: Path, wanted: tuple[str, ...], python: str, make: Maker = make_film
) -> dict[str, Score]:
    """A film's scores by method; made where they are not there."""
    truth = make(seed, folder)
    out: dict[str, Score] = {}
    for stage in wanted:
        run = partial(STAGES[stage], folder / f"{seed:04d}.mp4", truth, python)
        out |= _kept(folder / f"{seed:04d}.{stage}.json", run)
    return out


def scored_kind(seed: int, folder: Path) -> dict[str, Score]:
    """A set's scores; made where they are not there."""
    return _kept(folder / f"{seed:04d}.kinds.json", partial(kinds_stage, seed, folder))


def _kept(file: Path, run: Callable[[], dict[str, Score]]) -> dict[str, Score]:
    if not file.exists():
        scores = run()
        unfinished = file.with_suffix(".part")
        unfinished.write_text(json.dumps({name: asdict(score) for name, score in scores.items()}, indent=1))
        unfinished.replace(file)
    return {name: Score(**values) for name, values in json.loads(file.read_text()).items()}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.calibration", description=__doc__)
    add(parser, OPTIONS)
    given = parser.parse_args(arguments)
    if given.duplicates:
        made = partial(duplicates_outcome, folder=given.folder, photographs=given.photographs)
        with ProcessPoolExecutor(max_workers=given.jobs) as pool:
            print(duplicates_table(list(pool.map(made, range(given.first, given.first + given.films)))))
        return
    wanted = ("look",) if given.plain else tuple(given.stages)
    make = make_plain_film if given.plain else make_large_film if given.large else make_film
    make = make_photograph_film if given.real else make
    job = partial(scored, folder=given.folder, wanted=wanted, python=given.python, make=make)
    if given.kinds:
        job = partial(scored_kind, folder=given.folder)
    by_method: dict[str, list[Score]] = {}
    with ProcessPoolExecutor(max_workers=given.jobs) as pool:
        for k, scores in enumerate(pool.map(job, range(given.first, given.first + given.films)), 1):
            print(f"{k} of {given.films} {'sets' if given.kinds else 'films'}", file=sys.stderr, flush=True)
            for name, score in scores.items():
                by_method.setdefault(name, []).append(score)
    for name, all_scores in by_method.items():
        print(f"\n## {name}, {len(all_scores)} films or sets\n\n{table(all_scores)}")
    if {"sfm, train, measure", "pyidi"} <= by_method.keys():
        against = compared(by_method["sfm, train, measure"], by_method["pyidi"])
        print(f"\nrms error of a series over pyidi's: {against}")


if __name__ == "__main__":
    main()
