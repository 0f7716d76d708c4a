"""The motion stage on the first T timesteps of one capture: what it costs as T grows, and how good it is.

    python -m benchmarks.motion_length SET [--timesteps 30,37,60,150,300] [--noise 0.01] [--band 4 6]

SET is a generated dataset with truth/motion.npz. The space stage runs once, on all timesteps. Times are seconds of the
processor: `decode` of reading files, `components` of the differences in few temporal components (R of them), `solve` of
all else of the motion stage, which goes by R and not by T. K is the number of modes. `error` is the displacement error;
`bins` that of the same motion as bins of a Fourier transform about its mean over time, which is what a method without
tones would give; `in band` and `bins in b.` are those of the modes in the band. `--noise`: standard deviation of noise
that is new in every picture. Run it with OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1: times of many threads are no sum.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common import machine
from tg4mm.capture import Capture, ImageStack, load_capture, load_images
from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion.animate import displacement_at
from tg4mm.fit.motion.checkpoints import no_checkpoint
from tg4mm.fit.motion.nuisance.first_look import look_at
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.temporal.synchronous import principal_components
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.truth import exact_motion, load_truth
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion
from tg4mm.run.stages.space import train_space
from tg4mm.show.weights import blending_weights

HEAD = ("T", "decode s", "components s", "solve s", "R", "K", "error", "bins", "in band", "bins in b.")


@dataclass(frozen=True)
class Subject:
    """A capture with a run of it whose space stage is done."""

    capture: Capture
    images: ImageStack
    run: Run
    weights: np.ndarray  # [N] of the Gaussians

    def first(self, n_timesteps: int) -> tuple[Capture, ImageStack]:
        """The capture's first timesteps."""
        c = self.capture
        rows = c.timesteps < n_timesteps
        paths = tuple(path for path, keep in zip(c.paths, rows, strict=True) if keep)
        names = ("viewmats", "Ks", "timesteps", "camera_ids", "times_s")
        arrays = {name: getattr(c, name)[rows] for name in names}
        return replace(c, n_timesteps=n_timesteps, paths=paths, **arrays), ImageStack(self.images.data[rows])

    def truth(self, n_timesteps: int) -> ModalMotion:
        """The exact motion of the Gaussians in them."""
        whole = load_truth(self.capture.root, self.capture.fps, self.capture.n_timesteps)
        motion = exact_motion(whole, self.run.load_space().means.numpy())
        gains = None if motion.gains is None else motion.gains[:, :n_timesteps]
        return replace(motion, n_timesteps=n_timesteps, gains=gains)


def noisy(images: ImageStack, deviation: float) -> ImageStack:
    """The pictures over white, each with noise of its own, 8 bits."""
    rng = np.random.default_rng(0)
    out = np.full(images.data.shape, 255, np.uint8)
    for i in range(len(images)):
        rgb = images.rgb(i)
        noise = rng.standard_normal(rgb.shape, np.float32) * np.float32(deviation)
        out[i, ..., :3] = np.clip((rgb + noise) * 255 + 0.5, 0, 255)
    return ImageStack(out)


def by_bins(motion: ModalMotion) -> ModalMotion:
    """The same motion at whole timesteps, as all bins of a Fourier transform."""
    series = np.stack([displacement_at(motion, t) for t in range(motion.n_timesteps)])
    freqs, values = series_modes(series - series.mean(0), motion.fps)
    return replace(motion, freqs_hz=freqs, displacement=values, rotation=0 * values, appearance=None)


def inside(motion: ModalMotion, band: tuple[float, float]) -> ModalMotion:
    return motion.selected((motion.freqs_hz >= band[0]) & (motion.freqs_hz <= band[1]))


def row(subject: Subject, n_timesteps: int, decode: float, band: tuple[float, float]) -> tuple[float, ...]:
    """What HEAD says, of the first timesteps."""
    capture, images = subject.first(n_timesteps)
    config, gaussians = MotionConfig(), subject.run.load_space()
    observations = observe(capture, images)
    began = time.process_time()
    seen = look_at(gaussians, observations, config, "cpu", no_checkpoint)
    targets = principal_components(observations, seen.look, seen.nuisances, config.components)
    reading = time.process_time() - began
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(Path(folder) / "run", capture.root, "modal", {})
        run.save_space(gaussians, {})
        began = time.process_time()
        found = train_motion(run, capture, images, config)
        solving = time.process_time() - began - reading
    true, bins = subject.truth(n_timesteps), by_bins(found)
    moving = found.selected(
        found.freqs_hz > 0
    )  # from the motion's own zero, not from where the Gaussians lie
    pairs = [(moving, true), (bins, true)]
    pairs += [(inside(a, band), inside(b, band)) for a, b in pairs]
    errors = [displacement_figures(a, b, subject.weights)["relative_error"] for a, b in pairs]
    share = n_timesteps / subject.capture.n_timesteps
    return n_timesteps, decode * share, reading, solving, len(targets.basis), len(found.freqs_hz), *errors


def subject_of(data: Path, folder: Path, noise: float, iterations: int) -> tuple[Subject, float]:
    """The set with its Gaussians, and the seconds of decoding."""
    capture = load_capture(data)
    began = time.process_time()
    images = load_images(capture)
    decode = time.process_time() - began
    if noise:
        images = noisy(images, noise)
    run = Run.create(folder / "space", capture.root, "modal", {})
    train_space(run, rest_views(capture, images), capture.points, SpaceConfig(iterations=iterations), "cpu")
    return Subject(capture, images, run, blending_weights(run.load_space(), capture)), decode


def main() -> None:
    """Print a row for each length."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--timesteps", default="30,37,60,150,300")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument(
        "--band", nargs=2, type=float, help="Hz (default: 0.5 and 1.5 times the first frequency)"
    )
    parser.add_argument("--space-iterations", type=int, default=1000)
    options = parser.parse_args()
    lengths = [int(t) for t in options.timesteps.split(",")]
    print(machine())
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        subject, decode = subject_of(options.data, Path(folder), options.noise, options.space_iterations)
        capture = subject.capture
        main_frequency = float(subject.truth(capture.n_timesteps).freqs_hz[0])
        low, high = options.band or (main_frequency / 2, main_frequency * 1.5)
        print(
            f"{capture.root.name}: {len(subject.weights)} Gaussians, {len(capture) // capture.n_timesteps} views of "
            f"{capture.width}×{capture.height}, noise {options.noise:g}, band {low:g} to {high:g} Hz"
        )
        print("  ".join(f"{name:>12}" for name in HEAD))
        for n_timesteps in lengths:
            values = row(subject, min(n_timesteps, capture.n_timesteps), decode, (low, high))
            print("  ".join(f"{value:12.4g}" for value in values), flush=True)


if __name__ == "__main__":
    main()
