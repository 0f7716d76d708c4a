"""Effects of a phone on a picture: films with exact truth, one effect each, through look and sfm, train, measure.

A plate vibrates before a still wall; texture, place, frequency and size of its motion are drawn by a seed, the same for
every effect. 10 s of 320×180 at 30 Hz, HEVC. The table: what is found of the truth, and whether the effect is named.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.draw import FilmTruth, TrueVibration
from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture, write_video
from benchmarks.calibration.score import Score, share
from benchmarks.calibration.stages import look_stage, whole_stage

FPS, FRAMES, NOISE, BITS_PER_S = 30, 300, 2.5, 1_500_000
SECONDS = FRAMES / FPS
MARGIN = 14  # pixels beside what is shown, which a drifting picture reaches into
Course = Callable[[float], float]

OPTIONS: dict[str, Any] = {
    "out": {"type": Path, "metavar": "DIR"},
    "--effects": {"nargs": "*", "default": [], "metavar": "NAME", "help": "default: all"},
    "--seeds": 4,
    "--first": 0,
    "--stages": {"nargs": "*", "default": ["look", "whole"], "choices": ["look", "whole"]},
}


@dataclass(frozen=True)
class Effect:
    """Strengths of the effects on a film; 0 or 1 is no effect."""

    shift: Callable[[float], np.ndarray] = lambda t: np.zeros(2)  # pixels right and down
    zoom: Course = lambda t: 0.0  # relative, about the picture's middle
    light: Course = lambda t: 1.0
    tint: Callable[[float], np.ndarray] | None = None  # [3] relative, of red, green, blue
    times_s: Sequence[float] | None = None
    is_hlg: bool = False
    is_portrait: bool = False
    named: str = ""  # regular expression of its name in the text


def effects(rng: np.random.Generator) -> dict[str, Effect]:
    """Drawn anew by each generator."""
    hunts = np.sort(rng.uniform(1, 9, 2)), rng.choice([-1, 1], 2) * rng.uniform(0.002, 0.004, 2)
    drift_hz, phases = rng.uniform(0.02, 0.3, 12), rng.uniform(0, 2 * np.pi, (2, 12))
    pump_hz, pump = rng.uniform(1.5, 3), rng.uniform(0.0005, 0.002)
    at, stops = np.sort(rng.uniform(1, 9, 3)), rng.choice([-1, 1], 3) * rng.uniform(1 / 6, 1 / 3, 3)
    whites = rng.choice([-1, 1], 3) * rng.uniform(0.04, 0.1, 3)
    kept = np.sort(rng.permutation(FRAMES + 12)[:FRAMES])
    jitter = np.clip(rng.normal(0, 0.0015, FRAMES), -0.005, 0.005)

    def steps(sizes: np.ndarray, ramp_s: float) -> Course:
        return lambda t: float(sizes @ np.clip((t - at) / ramp_s, 0, 1))

    def hunting(t: float) -> float:
        x = (t - hunts[0]) / 0.15
        return float(hunts[1] @ (np.exp(-(x**2) / 2) - 0.6 * np.exp(-((x - 2) ** 2) / 2)))

    dim, warm = steps(stops, 0.1), steps(whites, 0.3)
    return {
        "none": Effect(),
        "stabilisation": Effect(
            shift=lambda t: np.cos(2 * np.pi * drift_hz * t + phases).sum(1) / 6**0.5,
            named="camera (itself moved|shake)",
        ),
        "focus hunts": Effect(zoom=hunting, named="grows and shrinks"),
        "focus pumps": Effect(
            zoom=lambda t: pump * float(np.cos(2 * np.pi * pump_hz * t)), named="grows and shrinks"
        ),
        "exposure": Effect(light=lambda t: float(2 ** dim(t)), named="exposure or lamps"),
        "white balance": Effect(
            tint=lambda t: np.array([1 + warm(t), 1, 1 - warm(t)]), named="white balance changes"
        ),
        "HLG": Effect(is_hlg=True, named="HLG, 10 bits"),
        "portrait": Effect(is_portrait=True),
        "variable rate": Effect(times_s=(kept / FPS + jitter).tolist(), named="rate varies"),
    }


def film_of(name: str, seed: int, folder: Path) -> tuple[Path, FilmTruth]:
    """The film of an effect; written where it is not there."""
    rng = np.random.default_rng([17, seed])
    effect = effects(np.random.default_rng([18, seed]))[name]
    width, height = (180, 320) if effect.is_portrait else (320, 180)
    box_w, box_h = int(rng.integers(70, 110)), int(rng.integers(60, 100))
    left, upper = int(rng.integers(10, width - box_w - 10)), int(rng.integers(10, height - box_h - 10))
    hz, size = rng.uniform(3.5, 12), np.exp(rng.uniform(*np.log([0.06, 0.3])))
    angle, phase = rng.uniform(0, 6.28, 2)
    moves = (float(size * np.cos(angle)), float(size * np.sin(angle)))
    region = (left, upper, left + box_w, upper + box_h)
    vibration = TrueVibration(float(hz), moves, region, False, float(phase))
    truth = FilmTruth(
        width, height, FPS, FRAMES, NOISE, "libx265", BITS_PER_S / (width * height * FPS), [vibration]
    )
    video = folder / f"{name.replace(' ', '-')}-{seed}.mp4"
    if not video.exists():
        folder.mkdir(parents=True, exist_ok=True)
        pictures = _pictures(effect, truth, rng)
        coding = Coding("libx265", BITS_PER_S, None)
        if effect.is_portrait:
            pictures, coding = np.rot90(pictures, -1, (1, 2)), replace(coding, turn=90)
        write_video(video, np.ascontiguousarray(pictures), FPS, coding, effect.times_s)
    return video, truth


def _pictures(effect: Effect, truth: FilmTruth, rng: np.random.Generator) -> np.ndarray:
    """[F, H, W] or [F, H, W, 3]: drawn with a margin, and cut out where whole pixels of the drift have come to."""
    height, width = truth.height + 2 * MARGIN, truth.width + 2 * MARGIN
    down, right = np.mgrid[:height, :width] + 0.5
    away = np.stack([right - width / 2, down - height / 2], -1)
    zoom, own = FilmMode(away, effect.zoom), truth.vibrations[0]
    plate = tuple(n + MARGIN for n in own.region)
    sways = FilmMode(np.broadcast_to(own.amplitude_px, (height, width, 2)), own.motion())
    cloths = [texture(height, width, rng, c, m, (1.3, 3.0, 9.0)) for c, m in ((0.25, 0.3), (0.4, 0.25))]
    layers = [Layer(cloths[0], None, [zoom], 0.6), Layer(cloths[1], plate, [zoom, sways], 0.6)]

    def own_sway(t: float) -> np.ndarray:
        return effect.shift(t) - np.round(effect.shift(t))

    film = Film(
        layers, FPS, FRAMES, NOISE, effect.light, own_sway, times_s=effect.times_s, is_hlg=effect.is_hlg
    )
    times = np.arange(FRAMES) / FPS if effect.times_s is None else np.array(effect.times_s)
    corners = np.array([MARGIN - np.round(effect.shift(t)) for t in times]).astype(int)
    shown = zip(film.pictures(), corners, strict=True)
    cut = np.stack([p[y : y + truth.height, x : x + truth.width] for p, (x, y) in shown])
    if effect.tint is None:
        return cut
    gains = np.array([effect.tint(t) for t in times]) ** (1 / 2.2)
    return np.clip(np.round(cut[..., None] * gains[:, None, None]), 0, 255).astype(np.uint8)


def judged(video: Path, truth: FilmTruth, stage: str) -> tuple[Score, str]:
    """A stage's score, and all that it printed; made where they are not there."""
    kept = video.with_suffix(f".{stage}.json")
    if not kept.exists():
        folder = video.with_suffix("")
        if stage == "look":
            text = _printed("look", video, "--png", folder.with_suffix(".png"))
            score = look_stage(video, truth, "")["look"]
        else:
            text = _printed("sfm", video, "--out", folder / "set")
            text += _printed("train", folder / "set", "--out", folder / "run")
            is_there = (folder / "run" / "log.json").exists()
            score = whole_stage(video, truth, "")["sfm, train, measure"] if is_there else Score()
        kept.write_text(json.dumps({"score": asdict(score), "said": text}, indent=1))
    values = json.loads(kept.read_text())
    return Score(**values["score"]), values["said"]


def _printed(*words: object) -> str:
    command = [sys.executable, "-m", "tg4mm", *map(str, words)]
    ran = subprocess.run(command, capture_output=True, text=True)
    return ran.stdout + ran.stderr


def run(options: Any) -> None:
    """Print a table."""
    known = effects(np.random.default_rng(0))
    titles = "effect | by | named | frequency: errors in ± | amplitude/truth | errors in ± | false | named"
    print(f"| {titles} |\n|---|---|---:|---|---|---|---:|---:|")
    for name in options.effects or known:
        seeds = range(options.first, options.first + options.seeds)
        films = [film_of(name, seed, options.out) for seed in seeds]
        for stage in options.stages:
            scores, texts = zip(*(judged(*film, stage) for film in films), strict=True)
            count = sum(bool(re.search(known[name].named, text)) for text in texts)
            cells = [
                share(score.strongest_named for score in scores),
                ", ".join(f"{abs(z):.1f}" for score in scores for z in score.frequencies) or "–",
                ", ".join(f"{ratio:.2f}" for score in scores for ratio in score.ratios) or "–",
                ", ".join(f"{abs(z):.1f}" for score in scores for z in score.amplitudes) or "–",
                str(sum(len(score.false) for score in scores)),
                f"{count} of {len(texts)}" if known[name].named else "",
            ]
            print(f"| {name} | {stage} | {' | '.join(cells)} |", flush=True)
