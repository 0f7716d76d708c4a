"""Random films: texture, lens, noise, codec, motion and rate are drawn by a seed; what vibrates has exact truth."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, Motion, Region, texture, write_video
from tg4mm.core.files import write_json

SIZES = ((320, 180), (256, 144), (288, 160), (180, 320))
RATES = (24, 25, 30, 30, 50, 60, 120)
LEAST_PX, MOST_PX = 0.01, 0.5
_TRIES = 60


@dataclass(frozen=True)
class TrueVibration:
    """A motion amplitude · shape · cos(2πft + phase), or from start_s on e^(−δt) sin 2πf(t − start)."""

    hz: float
    amplitude_px: tuple[float, float]
    region: Region
    tilted: bool  # grows from its lower edge, where it stands, to its upper
    phase_rad: float
    damping: float | None = None
    start_s: float = 0.0

    @property
    def size_px(self) -> float:
        """At the upper edge."""
        return float(np.hypot(*self.amplitude_px))

    def at(self, y: float) -> float:
        """Share of the amplitude at a height in the picture."""
        _, upper, _, lower = self.region
        return float(np.clip((lower - y) / (lower - upper), 0, 1)) if self.tilted else 1.0

    def motion(self) -> Motion:
        """Its function of time."""
        if self.damping is None:
            return lambda t: float(np.cos(2 * np.pi * self.hz * t + self.phase_rad))
        decay = self.damping / np.sqrt(1 - self.damping**2) * 2 * np.pi * self.hz

        def ringing(t: float) -> float:
            x = t - self.start_s
            return float(np.exp(-decay * x) * np.sin(2 * np.pi * self.hz * x)) if x >= 0 else 0.0

        return ringing


@dataclass
class FilmTruth:
    """The true content of a film."""

    width: int
    height: int
    fps: int
    frames: int
    noise: float
    codec: str
    bits_per_pixel: float
    vibrations: list[TrueVibration] = field(default_factory=list)
    movers: list[tuple[str, Region]] = field(default_factory=list)
    flicker_hz: float | None = None  # folded below half the rate
    sway_px: float = 0.0

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return self.frames / self.fps


DrawnFilm = tuple[np.ndarray, Coding, FilmTruth]


def make_film(seed: int, folder: Path) -> FilmTruth:
    """Draw and write one film, as `Draw`."""
    return kept_film(seed, folder, Draw(seed).film)


def kept_film(seed: int, folder: Path, drawn: Callable[[], DrawnFilm]) -> FilmTruth:
    """folder/SEED.mp4 and SEED.json; those there are kept."""
    video, notes = folder / f"{seed:04d}.mp4", folder / f"{seed:04d}.json"
    if video.exists() and notes.exists():
        return read_truth(notes)
    folder.mkdir(parents=True, exist_ok=True)
    pictures, coding, truth = drawn()
    write_video(video, pictures, truth.fps, coding)
    write_json(notes, asdict(truth))
    return truth


def read_truth(path: Path) -> FilmTruth:
    """As `make_film` wrote it."""
    values = json.loads(path.read_text())
    values["vibrations"] = [
        TrueVibration(**v | {"amplitude_px": tuple(v["amplitude_px"]), "region": tuple(v["region"])})
        for v in values["vibrations"]
    ]
    values["movers"] = [(kind, tuple(region)) for kind, region in values["movers"]]
    return FilmTruth(**values)


class Draw:
    """One film's random numbers, and what they have placed so far."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([41, seed])
        self.seed = seed
        self.width, self.height = SIZES[rng.integers(len(SIZES))]
        self.fps, self.frames = int(rng.choice(RATES)), int(rng.integers(150, 331))
        self.duration = self.frames / self.fps
        self.blur = float(rng.choice([0.55, 0.55, 1.0, 1.6]))
        codec = str(rng.choice(["libx264", "libx264", "libx265"]))
        bits = float(np.exp(rng.uniform(np.log(0.08), np.log(3))))
        per_second = int(bits * self.width * self.height * self.fps)
        self.coding = Coding(codec, per_second, [None, 30, 12][rng.integers(3)])
        noise = float(rng.uniform(2, 8))
        self.truth = FilmTruth(self.width, self.height, self.fps, self.frames, noise, codec, bits)
        self.painters: list[Callable[[np.ndarray, float, int], np.ndarray]] = []

    def film(self) -> DrawnFilm:
        rng = self.rng
        layers = [Layer(self.surface(), None, [], self.blur)]
        layers += [Layer(self.surface(), self.box(), [], self.blur) for _ in range(rng.integers(0, 3))]
        for _ in range(int(rng.choice([0, 0, 0, 1, 1, 1, 1, 2, 2, 2]))):
            region = self._free_box()
            if region is not None:
                layers.append(Layer(self.surface(), region, list(self._modes(region)), self.blur))
        light, sway = self.light(), self.sway()
        for draw, chance in ((self._wheel, 0.25), (self._leaves, 0.25), (self._passer, 0.2)):
            if rng.random() < chance:
                draw()
        film = Film(layers, self.fps, self.frames, self.truth.noise, light, sway, self.painters, self.seed)
        return film.pictures(), self.coding, self.truth

    def surface(self) -> np.ndarray:
        rng = self.rng
        sizes = np.array([1.3, 3.0, 9.0]) * rng.uniform(0.9, 2.2)
        return texture(self.height, self.width, rng, rng.uniform(0.12, 0.45), rng.uniform(0.08, 0.5), sizes)

    def box(self) -> Region:
        rng = self.rng
        w = min(int(rng.integers(40, 131)), self.width - 10)
        h = min(int(rng.integers(32, 111)), self.height - 10)
        x, y = int(rng.integers(4, self.width - w - 4)), int(rng.integers(4, self.height - h - 4))
        return x, y, x + w, y + h

    def _is_free(self, box: Region, gap: int) -> bool:
        regions = {v.region for v in self.truth.vibrations}
        left, upper, right, lower = box[0] - gap, box[1] - gap, box[2] + gap, box[3] + gap
        return all(right < r[0] or left > r[2] or lower < r[1] or upper > r[3] for r in regions)

    def _free_box(self, gap: int = 0) -> Region | None:
        boxes = (self.box() for _ in range(_TRIES))
        return next((box for box in boxes if self._is_free(box, gap)), None)

    def _modes(self, region: Region) -> Iterator[FilmMode]:
        rng, tilted = self.rng, bool(self.rng.random() < 0.3)
        count = 1 if rng.random() < 0.7 else 2
        for k in range(count):
            vibration = self.vibration(region, tilted, 1.0 if k == 0 else 0.5)
            self.truth.vibrations.append(vibration)
            y = np.arange(self.height) + 0.5
            rise = np.array([vibration.at(v) for v in y]) if tilted else np.ones(self.height)
            shape = np.array(vibration.amplitude_px) * rise[:, None, None] * np.ones((1, self.width, 1))
            yield FilmMode(shape, vibration.motion())

    def vibration(self, region: Region, tilted: bool, factor: float) -> TrueVibration:
        """Draw the vibration of a region, at a frequency that no other has."""
        rng, d = self.rng, self.duration
        lowest, highest = np.log(max(4 / d, 0.03 * self.fps)), np.log(0.46 * self.fps)
        for _ in range(_TRIES):
            hz = float(np.exp(rng.uniform(lowest, highest)))
            if all(abs(hz - v.hz) > 2.2 / d for v in self.truth.vibrations):
                break
        size = float(np.exp(rng.uniform(np.log(LEAST_PX), np.log(MOST_PX)))) * factor
        angle = rng.uniform(0, 2 * np.pi)
        amplitude = (size * float(np.cos(angle)), size * float(np.sin(angle)))
        if rng.random() >= 0.3:
            return TrueVibration(hz, amplitude, region, tilted, float(rng.uniform(0, 2 * np.pi)))
        start = 0.0 if rng.random() < 0.5 else float(rng.uniform(0, 0.3) * d)
        least = 0.5 / (2 * np.pi * hz * (d - start))  # a decay that the record shows
        damping = float(np.clip(rng.uniform(0.5, 2) / (np.pi * rng.uniform(3, 30)), max(least, 0.002), 0.06))
        return TrueVibration(hz, amplitude, region, tilted, 0.0, damping, start)

    def light(self) -> Motion:
        rng = self.rng
        if rng.random() >= 0.45:
            return lambda t: 1.0
        mains, depth, drift = int(rng.choice([100, 120])), rng.uniform(0.005, 0.05), rng.uniform(0, 0.05)
        phase, slow = rng.uniform(0, 2 * np.pi, 2)
        folded = abs(mains - round(mains / self.fps) * self.fps)
        self.truth.flicker_hz = float(folded) if folded else None
        return lambda t: float(
            (1 + depth * np.cos(2 * np.pi * mains * t + slow))
            * (1 + drift * np.sin(2 * np.pi * t / 9 + phase))
        )

    def sway(self) -> object:
        rng = self.rng
        if rng.random() >= 0.3:
            return lambda t: np.zeros(2)
        size = self.truth.sway_px = float(np.exp(rng.uniform(np.log(0.01), np.log(0.15))))
        phases, hz = rng.uniform(0, 2 * np.pi, (2, 12)), rng.uniform(0.05, 1.2, 12)
        return lambda t: size / 6**0.5 * np.cos(2 * np.pi * hz * t + phases).sum(1)

    def _wheel(self) -> None:
        rng = self.rng
        for _ in range(_TRIES):
            r = int(rng.integers(14, 30))
            x, y = int(rng.integers(r + 4, self.width - r - 4)), int(rng.integers(r + 4, self.height - r - 4))
            if self._is_free((x - r, y - r, x + r, y + r), 4):
                break
        else:
            return
        spokes, turns = int(rng.integers(2, 8)), rng.uniform(0.1, 0.45) * self.fps
        window = (slice(y - r - 4, y + r + 4), slice(x - r - 4, x + r + 4))
        across, along = np.meshgrid(np.arange(-r - 4, r + 4) + 0.5, np.arange(-r - 4, r + 4) + 0.5)
        angle = np.arctan2(along, across)
        opacity = 1 / (1 + np.exp(np.clip((np.hypot(across, along) - r) * 3, -50, 50)))
        shutter = np.linspace(0, 0.25 / self.fps, 4)

        def paint(picture: np.ndarray, t: float, k: int) -> np.ndarray:
            turned = [np.tanh(6 * np.cos(spokes * (angle - 2 * np.pi * turns * (t + s)))) for s in shutter]
            light = 0.33 + 0.25 * np.mean(turned, 0)
            picture[window] = picture[window] * (1 - opacity) + opacity * light
            return picture

        self.painters.append(paint)
        self.truth.movers.append(("wheel", (x - r, y - r, x + r, y + r)))

    def _leaves(self) -> None:
        rng, region = self.rng, self._free_box(12)
        if region is None:
            return
        n = 60
        places = np.stack([rng.uniform(region[0], region[2], n), rng.uniform(region[1], region[3], n)], 1)
        radius, light, keep = rng.uniform(3, 7, n), rng.uniform(0.05, 0.45, n), np.exp(-4 / self.fps)
        wind, size = np.zeros((self.frames, n, 2)), rng.uniform(0.5, 2.5)
        for k in range(1, self.frames):
            wind[k] = keep * wind[k - 1] + size * np.sqrt(1 - keep**2) * rng.normal(size=(n, 2))

        def paint(picture: np.ndarray, t: float, k: int) -> np.ndarray:
            for (x, y), r, value in zip(places + wind[k], radius, light, strict=True):
                rows = slice(max(int(y) - 9, 0), max(int(y) + 10, 0))
                columns = slice(max(int(x) - 9, 0), max(int(x) + 10, 0))
                part = picture[rows, columns]
                down, right = np.mgrid[: part.shape[0], : part.shape[1]]
                far = np.hypot(right + columns.start + 0.5 - x, down + rows.start + 0.5 - y)
                opacity = np.clip(r - far + 0.5, 0, 1)
                picture[rows, columns] = part * (1 - opacity) + opacity * value
            return picture

        self.painters.append(paint)
        self.truth.movers.append(("leaves", region))

    def _passer(self) -> None:
        rng, d, width, height = self.rng, self.duration, self.width, self.height
        cloth = texture(height, width, rng, 0.3, 0.15, (1.3, 3.0, 9.0))[1::3, 1::3]
        begins, speed = rng.uniform(0.1, 0.6) * d, width / d * rng.uniform(1, 3)
        down, right = np.mgrid[:height, :width] + 0.5

        def paint(picture: np.ndarray, t: float, k: int) -> np.ndarray:
            x = -20 + (t - begins) * speed
            if t < begins or x > width + 20:
                return picture
            below = np.abs(down - 0.6 * height - 2 * np.sin(2 * np.pi * 1.9 * t)) - 0.33 * height
            opacity = np.clip(0.5 - np.maximum(np.abs(right - x) - 10, below), 0, 1)
            return picture * (1 - opacity) + opacity * np.roll(cloth, round(x), 1)

        self.painters.append(paint)
        self.truth.movers.append(("passer-by", (0, int(0.27 * height), width, int(0.93 * height))))
