"""Two worked examples from film to decision: a pump with a bearing's line, and a footbridge, beside their truth.

Films of moving layers (`calibration/film.py`), looked at by `tg4mm look --regions`: a pump on its base, 240 frames a
second, 24.2 Hz of its shaft and 87.1 Hz of a bearing, 0.5 mm a pixel; a footbridge, 30 frames a second, whose first
mode (2.05 Hz) people keep in motion and whose second (5.63 Hz) rings down, 10 mm a pixel.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture, write_video
from benchmarks.common import print_found
from tg4mm.capture.look import look
from tg4mm.core.regions import Region, Regions, Scale, write_regions
from tg4mm.show.analyse.quantities import LIMITS
from tg4mm.show.look import LookText

OPTIONS: dict[str, Any] = {"out": Path, "--only": {"choices": ("pump", "bridge"), "help": "one of them"}}
WIDTH, HEIGHT = 320, 192
CODING = Coding("libx264", 20_000_000)


def _cosine(hz: float, phase: float) -> Any:
    return lambda t: float(np.cos(2 * np.pi * hz * t + phase))


def pump() -> tuple[Film, Regions, dict[str, list[tuple[float, float]]]]:
    """Film, regions, and (Hz, mm) of each region's lines."""
    rng = np.random.default_rng(1)
    right, up = np.zeros((HEIGHT, WIDTH, 2)), np.zeros((HEIGHT, WIDTH, 2))
    right[..., 0], up[..., 1] = 1.0, -1.0
    modes = [FilmMode(0.16 * right, _cosine(24.2, 0.3)), FilmMode(0.03 * up, _cosine(87.1, 1.0))]
    wall, body = (texture(HEIGHT, WIDTH, rng, 0.35, 0.35, (1.5, 4.0)) for _ in range(2))
    film = Film(
        [Layer(wall, None, [], 0.6), Layer(body, (96, 48, 224, 160), modes, 0.6)], 240, 960, 2.0, seed=1
    )
    regions = (Region("bearing", "box", (112, 64, 208, 144)), Region("base", "box", (0, 168, 320, 192)))
    scale = Scale((((96.0, 48.0), (224.0, 48.0), 0.064),))
    truth = {"bearing": [(24.2, 0.08), (87.1, 0.015)], "base": []}
    return film, Regions((WIDTH, HEIGHT), regions, scale), truth


def bridge() -> tuple[Film, Regions, dict[str, list[tuple[float, float]]]]:
    """The same; a deck between two piers, its modes a half and a whole sine."""
    rng = np.random.default_rng(2)
    along = np.clip((np.arange(WIDTH) + 0.5 - 20) / 280, 0, 1)
    shapes = []
    for n, size in ((1, 0.35), (2, 0.20)):
        field = np.zeros((HEIGHT, WIDTH, 2))
        field[..., 1] = -size * np.sin(n * np.pi * along)
        shapes.append(field)
    ring, zeta = 2 * np.pi * 5.63, 0.008

    def decays(t: float) -> float:
        return float(np.exp(-zeta * ring * t) * np.cos(ring * t))

    sky, deck = (texture(HEIGHT, WIDTH, rng, 0.35, 0.4, (1.5, 4.0)) for _ in range(2))
    modes = [FilmMode(shapes[0], _cosine(2.05, 0.4)), FilmMode(shapes[1], decays)]
    layers = [Layer(sky, None, [], 0.6), Layer(deck, (20, 80, 300, 128), modes, 0.6)]
    film = Film(layers, 30, 600, 2.0, seed=2)
    regions, truth = [], {}
    for name, x in (("quarter", 90), ("middle", 160)):
        regions.append(Region(name, "box", (x - 16, 88, x + 16, 120)))
        share = float(np.mean(along[x - 16 : x + 16]))
        truth[name] = [(2.05, 3.5 * np.sin(np.pi * share)), (5.63, 2.0 * abs(np.sin(2 * np.pi * share)))]
    truth["middle"] = truth["middle"][:1]  # a node of the second
    scale = Scale((((20.0, 80.0), (300.0, 80.0), 2.8),))
    return film, Regions((WIDTH, HEIGHT), tuple(regions), scale), truth


def run(options: Any) -> None:
    """Writes OUT/NAME.mp4 and NAME-regions.json, and prints what is found and what is true."""
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for make in (pump, bridge):
        name = make.__name__
        if options.only not in (None, name):
            continue
        film, regions, truth = make()
        video, file = options.out / f"{name}.mp4", options.out / f"{name}-regions.json"
        write_video(video, film.pictures(), film.fps, CODING)
        write_regions(file, regions)
        found = look(video, regions=regions)
        assert regions.scale is not None
        for one in found.regions:
            squares = 0.0
            for hz, mm in truth[one.region.name]:
                line = min(one.lines, key=lambda each, hz=hz: abs(each.hz - hz))
                moves = regions.scale.metres_at(one.region.centre) @ line.direction
                size = 1e3 * float(np.linalg.norm(moves))
                sure = float(np.hypot(line.amplitude_deviation_px, regions.scale.share * line.amplitude_px))
                squares += (2 * np.pi * line.hz * size * line.amplitude_px) ** 2 / 2
                rows.append((f"{name} {one.region.name}, Hz", line.hz, line.hz_deviation, hz))
                rows.append((f"{name} {one.region.name}, mm", size * line.amplitude_px, size * sure, mm))
                if line.damping is not None and line.damping_deviation is not None:
                    rows.append((f"{name} {one.region.name}, ζ", line.damping, line.damping_deviation, 0.008))
            if name == "pump" and truth[one.region.name]:
                zone = "ABCD"[int(np.searchsorted(LIMITS["II"], squares**0.5))]
                speed = f"{squares**0.5:.2f} mm/s rms up to 120 Hz"
                print(f"{one.region.name}: {speed}: zone {zone} of class II, or worse")
            if not truth[one.region.name]:
                print(f"{one.region.name}: {len(one.lines)} lines; true are 0")
        print("\n".join(LookText(found, video, drawn=regions, drawn_file=file).lines()))
    print_found(rows)
