"""The loss of small motion by compression, and its estimate by the blind test, on random films.

python -m benchmarks codec_loss [--films N] [--first SEED]: a line for each film, then rms errors and coverage.
"""

import argparse
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from scipy.ndimage import gaussian_filter
from skimage import data
from skimage.transform import resize

from tg4mm.capture.codec import Loss, MeasuredTone, before_compression, codec_losses
from tg4mm.capture.codec.trial import gain_of, shifts_of
from tg4mm.capture.tracking.template import slope as slope_of

WIDTH, HEIGHT, FRAMES, FPS = 240, 136, 150, 30
_PHOTOGRAPHS = ("astronaut", "brick", "camera", "chelsea", "coffee", "grass", "gravel", "rocket")
OPTIONS = {"--films": 24, "--first": 100}
PLATE = slice(30, 100), slice(40, 150)
REGION = np.zeros((HEIGHT, WIDTH), bool)
REGION[36:94, 46:144] = True


@dataclass(frozen=True)
class CodecFilm:
    """A film with randomly drawn parameters."""

    codec: str
    options: dict[str, str]
    gop: int  # frames from key to key, at most
    noise: float  # of 255, each channel
    hz: float
    amplitude: float  # pixels
    photograph: str  # of scikit-image; "": a random texture

    @staticmethod
    def of(seed: int) -> "CodecFilm":
        rng = np.random.default_rng(seed)
        bits = float(np.exp(rng.uniform(np.log(0.08), np.log(3)))) * WIDTH * HEIGHT * FPS
        options = {"b": str(round(bits))}
        if seed % 3 == 0:
            options["x265-params"] = "log-level=none"
        else:
            options["preset"] = str(rng.choice(["medium", "veryfast"]))
            options |= {"maxrate": options["b"], "bufsize": options["b"]} if rng.random() < 0.4 else {}
            options |= {"bf": "0"} if rng.random() < 0.3 else {}
        if photograph := (_PHOTOGRAPHS[seed // 2 % len(_PHOTOGRAPHS)] if seed % 2 and seed % 3 else ""):
            options = {"crf": str(rng.integers(17, 30)), "preset": str(rng.choice(["medium", "slow"]))}
        cycles = round(float(np.exp(rng.uniform(np.log(0.03), np.log(0.45)))) * FRAMES)
        return CodecFilm(
            "libx264" if seed % 3 else "libx265",
            options,
            int(rng.choice([FPS, 250])),
            float(np.exp(rng.uniform(np.log(2), np.log(8)))),
            cycles * FPS / FRAMES,
            float(np.exp(rng.uniform(np.log(0.01), np.log(0.4 if photograph else 0.06)))),
            photograph,
        )

    def write(self, path: Path, seed: int) -> None:
        rng = np.random.default_rng(seed)
        blobs = gaussian_filter(rng.normal(size=(HEIGHT, WIDTH, 3)), (2, 2, 0))
        base = 128 + 35 * blobs / blobs.std()
        if self.photograph:
            whole = resize(getattr(data, self.photograph)(), (2 * HEIGHT, 2 * WIDTH), anti_aliasing=True)
            base = 255 * whole.reshape(*whole.shape[:2], -1)[68:204, 120:360] + np.zeros(3)
        slope = np.zeros_like(base)
        slope[PLATE] = slope_of(base, 1)[PLATE]
        with av.open(str(path), "w") as container:
            stream = container.add_stream(self.codec, rate=FPS)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.bit_rate, stream.codec_context.gop_size = int(self.options.get("b", 0)), self.gop
            stream.codec_context.options = self.options
            for k in range(FRAMES):
                moved = base - self.amplitude * np.cos(2 * np.pi * self.hz * k / FPS) * slope
                seen = np.clip(moved + rng.normal(0, self.noise, base.shape), 0, 255).astype(np.uint8)
                frame = av.VideoFrame.from_ndarray(seen, format="rgb24")
                frame.pts, frame.time_base = k, Fraction(1, FPS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())


def tried(seed: int) -> tuple[float, float, float, float, float]:
    """Return the true gain and its error, the estimated gain and its deviation, and 1 for a mark."""
    drawn = CodecFilm.of(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        drawn.write(path, seed)
        with av.open(str(path)) as container:
            luma = np.stack([f.to_ndarray()[: f.height] for f in container.decode(video=0)])
        true = MeasuredTone(drawn.hz, np.array([drawn.amplitude + 0j, 0]))
        times = np.arange(FRAMES) / FPS
        found = gain_of(shifts_of(luma, [REGION.astype(np.float32)], times)[0], [true], 0, times)
        (loss,) = codec_losses(path, [REGION], [[MeasuredTone(drawn.hz, true.phasor * found.gain)]], FPS)[0]
    print(f"{seed}: {drawn}: true {found.gain:.2f} ± {found.error:.2f}", end=", ")
    print(f"estimate {loss.gain:.2f} ± {loss.deviation:.2f}", flush=True)
    return found.gain, found.error, loss.gain, loss.deviation, float(bool(loss.why))


def run(options: argparse.Namespace) -> None:
    """Print a line for each film, then the figures over all."""
    rows = np.array([tried(seed) for seed in range(options.first, options.first + options.films)])
    off, sure = np.abs(rows[:, 0] - rows[:, 2]), np.hypot(rows[:, 1], rows[:, 3])
    rms, from_one = (np.sqrt((x**2).mean()) for x in (off, rows[:, 0] - 1))
    print(f"true - estimate, rms: {rms:.3f}; true - 1: {from_one:.3f}; of {len(rows)} within one deviation")
    print(f"{(off < sure).mean():.0%}, within two {(off < 2 * sure).mean():.0%}")
    rows = rows[rows[:, 4] == 0, :4]  # without a mark: measured and corrected amplitudes
    sizes, sure = np.array([before_compression(g, e, Loss(estimate, d)) for g, e, estimate, d in rows]).T
    raw, off = (np.sqrt(((x - 1) ** 2).mean()) for x in (rows[:, 0], sizes))
    one, two = ((np.abs(sizes - 1) < n * sure).mean() for n in (1, 2))
    print(f"amplitude of {len(rows)} without a mark, rms error: {raw:.3f}; corrected {off:.3f},", end=" ")
    print(f"± {np.median(sure):.3f} (median), within one deviation {one:.0%}, within two {two:.0%}")
