"""Renders and scores a split's images, each distinct (motion state, camera, ground truth) once."""

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.truth_file import TRUTH_FILE, load_truth
from tg4mm.core.magnification import AS_CAPTURED, Magnification, check_bands
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animate, mode_gains
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.displacement import displacement_figures, exact_motion, mean_squares
from tg4mm.run import Run
from tg4mm.run.checks import check_times
from tg4mm.run.preset import method_of, poses_of
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.maps import blending_weights
from tg4mm.show.render.image import render_images

BACKGROUND = (1.0, 1.0, 1.0)  # both the rendering and the ground truth are composited on white
Metric = Callable[[np.ndarray, np.ndarray], float]  # (image, truth) -> value
Key = tuple[Any, ...]
_CAMERAS_AT_ONCE = 8  # images held while one motion state is scored
_THREADS = 2  # FLIP is parallel inside; a second thread overlaps it with SSIM
STATIC, OURS, CEILING = "nothing moves", "ours", "ceiling"
_TIMES = 2.0  # error over its stated deviation that counts as within it
_ONE_PERIOD = 0.99  # periods in the record that resolve a frequency


@dataclass(frozen=True)
class Posing:
    """Magnified Gaussians by any method of `tg4mm.fit.magnify`."""

    at: Callable[[float], Callable[[float], Gaussians]]  # alpha -> timestep -> Gaussians
    label: str  # everything that determines the poses: method, filter, bands, model


@dataclass(frozen=True)
class ScoredMotion:
    """One row of the table: the Gaussians moved by `motion` (None: at rest), magnified in the bands of `magnified`."""

    name: str
    motion: ModalMotion | None
    magnified: Magnification = AS_CAPTURED  # its α is replaced
    posing: Posing | None = None  # the run's posing and magnification instead

    def state(self, t: int, alpha: float) -> Key:
        """Return a key of the pose at (t, α); equal keys mean equal poses, `()` the rest pose of every method.

        Per mode the factors of the phasors' real and imaginary parts (g cos θ and −g sin θ, g = 1 + α in the
        band), left out where that part is zero for all Gaussians: motion in phase repeats within its period.
        """
        if self.posing is not None:
            return (self.name, alpha, t)
        if self.motion is None:
            return ()
        phase = mode_gains(self.motion, t, self._alphas(alpha))
        has_re, has_im = self._parts
        factors = np.stack([phase.real * has_re, -phase.imag * has_im]).round(9) + 0.0  # + 0.0: -0 is 0
        return (self.name, tuple(factors.ravel().tolist())) if factors.any() else ()

    def pose(self, gaussians: Gaussians, t: int, alpha: float) -> Gaussians:
        """Return the method's Gaussians at timestep t, magnified by α."""
        if self.posing is not None:
            return self.posing.at(alpha)(t)
        if self.motion is None:
            return gaussians
        return animate(gaussians, self.motion, t, self._alphas(alpha))

    def _alphas(self, alpha: float) -> np.ndarray:
        assert self.motion is not None
        return self.magnified.times(alpha).ideal(self.motion.freqs_hz)

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return whether any Gaussian's phasor of mode k has a real part and an imaginary part: two [K] bool."""
        assert self.motion is not None
        has_re, has_im = self.motion.series.real.any(axis=1), self.motion.series.imag.any(axis=1)
        if (light := self.motion.appearance) is None:
            return has_re, has_im
        return has_re | light.parts[0], has_im | light.parts[1]


@dataclass(frozen=True)
class Scorer:
    """Scores methods against images; equal images are rendered and scored once."""

    gaussians: Gaussians
    metrics: Mapping[str, Metric]
    use_cache: bool = True
    scores: dict[Key, dict[str, float]] = field(default_factory=dict)

    def score(
        self,
        methods: list[ScoredMotion],
        capture: Capture,
        images: ImageStack,
        alpha: float,
        update: Callable[[int], None],
    ) -> dict[str, list[dict[str, float]]]:
        """Return {method: metrics of each image of the capture}. `update(done)` counts images × methods."""
        keys = self._keys(methods, capture, images, alpha)
        done = 0
        for method in methods:
            copies = Counter(keys[method.name])
            todo: dict[Key, dict[Key, int]] = {}  # motion state -> score key -> an image that has it
            for i, key in enumerate(keys[method.name]):
                if key not in self.scores:
                    todo.setdefault(key[0], {}).setdefault(key, i)
            done += sum(n for key, n in copies.items() if key in self.scores)
            for wanted in todo.values():
                for key, values in self._score_state(method, capture, images, alpha, wanted):
                    self.scores[key] = values
                    done += copies[key]
                    update(done)
            update(done)
        return {name: [self.scores[key] for key in rows] for name, rows in keys.items()}

    def _keys(
        self, methods: list[ScoredMotion], capture: Capture, images: ImageStack, alpha: float
    ) -> dict[str, list[Key]]:
        """Return, for each method, the key (motion state, camera, pixels) of each image."""
        n = range(len(images))
        if not self.use_cache:
            return {m.name: [((m.name, int(capture.timesteps[i])), i, alpha) for i in n] for m in methods}
        scenes = [(camera_key(capture, i), content_key(images.data[i])) for i in n]
        times = np.unique(capture.timesteps).tolist()
        states = {m.name: {t: m.state(t, alpha) for t in times} for m in methods}
        return {m.name: [(states[m.name][int(capture.timesteps[i])], *scenes[i]) for i in n] for m in methods}

    def _score_state(
        self, method: ScoredMotion, capture: Capture, images: ImageStack, alpha: float, wanted: dict[Key, int]
    ) -> Iterator[tuple[Key, dict[str, float]]]:
        """Score the images `wanted` of one motion state; each camera is rendered once, a few at a time."""
        by_camera: dict[Any, list[Key]] = {}
        for key in wanted:
            by_camera.setdefault(key[1], []).append(key)
        posed = method.pose(self.gaussians, int(capture.timesteps[next(iter(wanted.values()))]), alpha)
        groups = list(by_camera.values())
        for start in range(0, len(groups), _CAMERAS_AT_ONCE):
            some = groups[start : start + _CAMERAS_AT_ONCE]
            rendered = render_views(posed, capture, np.array([wanted[keys[0]] for keys in some]))
            jobs = [(image, key) for image, keys in zip(rendered, some, strict=True) for key in keys]
            with ThreadPoolExecutor(_THREADS) as pool:
                values = pool.map(lambda job: self._measure(job[0], images, wanted[job[1]]), jobs)
                yield from zip((key for _, key in jobs), values, strict=True)

    def _measure(self, image: np.ndarray, images: ImageStack, i: int) -> dict[str, float]:
        truth = images.rgb(i, background=BACKGROUND).clip(0.0, 1.0)
        return {name: metric(image, truth) for name, metric in self.metrics.items()}


def render_views(gaussians: Gaussians, capture: Capture, which: np.ndarray) -> np.ndarray:
    """Render the capture's cameras `which` [n] on white as [n, H, W, 3] float32 in 0..1."""
    size = capture.width, capture.height
    return render_images(gaussians, capture.viewmats[which], capture.Ks[which], size, BACKGROUND)


def camera_key(capture: Capture, i: int) -> bytes:
    """Return pose, intrinsics and size of image i as bytes, equal for equal cameras of any split or α."""
    size = np.array([capture.width, capture.height])
    return b"".join(a.tobytes() for a in (capture.viewmats[i].round(9) + 0.0, capture.Ks[i].round(9), size))


def content_key(*arrays: np.ndarray) -> bytes:
    """Return a digest of the arrays' contents, such as an image's pixels."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def closure(ours: float, static: float, ceiling: float) -> float | None:
    """Return (ours − static) / (ceiling − static); None if the ceiling is no better than nothing moving."""
    return (ours - static) / (ceiling - static) if ceiling > static else None


def change_figures(
    gaussians: Gaussians,
    ours: ScoredMotion,
    ceiling: ScoredMotion,
    capture: Capture,
    alpha: float,
    update: Callable[[int], None] = lambda done: None,
) -> dict[str, float | None]:
    """Return `change_gain` and `change_residual` over the capture's pictures, magnified by α; None without a change.

    With a and c the changes of the picture by `ours` and `ceiling` (all pixels and colours, white background):
    gain g = Σ a·c / Σ c², residual rms(a − g c) / rms(c). The exact motion has 1 and 0, nothing moving 0 and 0, a
    change unrelated to the motion 0 and its relative size. `update(done)` counts pictures.
    """
    products = np.zeros(3)  # a·a, a·c, c·c
    known: dict[Key, np.ndarray] = {}
    rest = ScoredMotion("rest", None)
    for t in np.unique(capture.timesteps).tolist():
        rows = np.flatnonzero(capture.timesteps == t)
        states = ours.state(t, alpha), ceiling.state(t, alpha)
        keys = {int(i): (*states, camera_key(capture, int(i))) for i in rows}
        todo = [i for i, key in keys.items() if key not in known]
        for first in range(0, len(todo), _CAMERAS_AT_ONCE):
            some = todo[first : first + _CAMERAS_AT_ONCE]
            shown = [
                render_views(method.pose(gaussians, t, alpha), capture, np.array(some)).astype(np.float64)
                for method in (ours, ceiling, rest)
            ]
            a, c = shown[0] - shown[2], shown[1] - shown[2]
            for k, i in enumerate(some):
                known[keys[i]] = np.array([(a[k] ** 2).sum(), (a[k] * c[k]).sum(), (c[k] ** 2).sum()])
        products += sum(known[key] for key in keys.values())
        update(int(np.sum(capture.timesteps <= t)))
    gain, residual = regressed(products)
    return {"change_gain": gain, "change_residual": residual}


def regressed(products: np.ndarray) -> tuple[float | None, float | None]:
    """Return gain g = Σ a·c / Σ c² and residual rms(a − g c) / rms(c) from [Σ a·a, Σ a·c, Σ c·c]; None if c is 0."""
    aa, ac, cc = products
    if not cc > 0:
        return None, None
    gain = float(ac / cc)
    return gain, float(np.sqrt(max(aa - gain * ac, 0.0) / cc))


@dataclass(frozen=True)
class Subject:
    """A run's Gaussians with their estimated and exact motion."""

    gaussians: Gaussians
    estimated: ModalMotion | None
    exact: ModalMotion | None
    uncertainty: np.ndarray | None  # [N] standard deviation of the displacement, scene units, if known
    magnified: Magnification  # its α is replaced by each evaluated one
    from_zero: bool  # a mode of 0 Hz is the offset to the motion's zero, from which the truth counts
    posing: Posing | None  # None: modal, by the estimated motion

    @property
    def methods(self) -> list[ScoredMotion]:
        found = [ScoredMotion(STATIC, None)]
        if self.estimated is not None:
            found.append(ScoredMotion(OURS, self.estimated, self.magnified, self.posing))
        if self.exact is not None:
            found.append(ScoredMotion(CEILING, self.exact))
        return found


def subject_of(
    run: Run, capture: Capture, magnified: Magnification, absent: dict[str, str], device: str
) -> Subject:
    """Return what is scored: the run's Gaussians and motion, and the exact motion if known; gaps go into `absent`."""
    gaussians = run.load_space()
    estimated = run.load_motion()
    if estimated is None:
        absent["ours"] = (
            f"{run.path} has no motion: its motion stage is not finished, or the capture is one timestep"
        )
    else:
        check_times(
            run.path, run.dataset, (estimated.fps, estimated.n_timesteps), (capture.fps, capture.n_timesteps)
        )
    exact = None
    if (run.dataset / TRUTH_FILE).is_file() and capture.n_timesteps > 1:
        truth = load_truth(run.dataset, capture.fps, capture.n_timesteps)
        exact = exact_motion(truth, gaussians.means.numpy())
    else:
        absent["ceiling"] = (
            f"{run.dataset / TRUTH_FILE} does not exist: no exact motion, no displacement error"
        )
    check_bands(magnified.limits, capture.fps)
    posing = None if estimated is None else _posing(run, magnified, device)
    from_zero = run.preset == "modal"
    uncertainty = run.load_uncertainty()
    return Subject(gaussians.to(device), estimated, exact, uncertainty, magnified, from_zero, posing)


def _posing(run: Run, magnified: Magnification, device: str) -> Posing | None:
    """Return the run's method of posing and magnification, or None if its modes are sufficient."""
    if method_of(run, magnified) == "modal":
        return None

    @lru_cache(maxsize=1)
    def at(alpha: float) -> Callable[[float], Gaussians]:
        return poses_of(run, magnified.times(alpha), device).at

    return Posing(at, repr((method_of(run, magnified), magnified.times(1.0), model_hash(run.path))))


def unresolved(exact: ModalMotion) -> dict[str, str]:
    """Return the exact motion that the record does not resolve, with less than one period, and the reason."""
    duration = exact.n_timesteps / exact.fps
    return {
        f"the motion at {hz:g} Hz": (
            f"the record of {exact.n_timesteps} timesteps at {exact.fps:g} Hz holds {hz * duration:.2g} of its period, "
            f"so that errors and closure do not judge a method; it takes {math.ceil(exact.fps / hz)} timesteps or more"
        )
        for hz in exact.freqs_hz.tolist()
        if 0 < hz * duration < _ONE_PERIOD
    }


def displacement_of(subject: Subject, capture: Capture, absent: dict[str, str]) -> dict[str, Any] | None:
    """Return `displacement_figures` of the run's motion, and of its part in the band; None without both motions.

    `uncertainty` holds `uncertainty_figures` if the run has its uncertainty.
    """
    estimated, exact = subject.estimated, subject.exact
    if estimated is None or exact is None:
        return None
    weights = blending_weights(subject.gaussians, capture)
    if not weights.sum() > 0:
        absent["displacement error"] = "no training camera sees any Gaussian"
        return None
    if subject.from_zero:
        estimated = estimated.selected(estimated.freqs_hz > 0)
    absent |= unresolved(exact)
    figures = displacement_figures(estimated, exact, weights, capture.unit_scale_m)
    if subject.uncertainty is not None:
        figures["uncertainty"] = uncertainty_figures(estimated, exact, weights, subject.uncertainty)
    if subject.magnified.bands:
        inside = [m.selected(subject.magnified.inside(m.freqs_hz)) for m in (estimated, exact)]
        figures["in_band"] = displacement_figures(inside[0], inside[1], weights, capture.unit_scale_m)
    return figures


def notes_of(subject: Subject) -> list[str]:
    """Return notes on motion that only "ours" or only the ground truth magnifies."""
    exact, bands = subject.exact, subject.magnified.limits
    if exact is None:
        return []
    moving, magnified = exact.powers() > 0, exact.is_magnified()
    inside = subject.magnified.inside(exact.freqs_hz)
    notes = []
    if bands and (outside := exact.freqs_hz[moving & magnified & ~inside]).size:
        notes.append(
            f"The ground truth also magnifies motion at {_hertz(outside)}, "
            f"outside the band {' and '.join(f'{low:g} to {high:g}' for low, high in bands)} Hz."
        )
    if (left := exact.freqs_hz[moving & ~magnified & inside]).size:
        where = "without a band, ours does" if not bands else "which lies inside the band"
        notes.append(f"The ground truth does not magnify motion at {_hertz(left)}, {where}.")
    return notes


def _hertz(frequencies: np.ndarray) -> str:
    return ", ".join(f"{f:g}" for f in frequencies) + " Hz"


def uncertainty_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, stated: np.ndarray
) -> dict[str, float]:
    """Compare the stated deviation [N] of each Gaussian's displacement (rms over time, scene units) with its error.

    `said` (the stated one), `error`: rms over Gaussians, weighted by `weights` [N], scene units. `within_two`: share of
    the weight with a true error, rms over time, of at most twice the stated one. Raises ValueError for another number
    of Gaussians.
    """
    if stated.shape != weights.shape:
        raise ValueError(f"the uncertainty is of {len(stated)} Gaussians, the weights of {len(weights)}")
    error2, stated2 = mean_squares(estimated, true)[0], stated.astype(np.float64) ** 2
    total = weights.sum()
    return {
        "said": float(np.sqrt((stated2 * weights).sum() / total)),
        "error": float(np.sqrt((error2 * weights).sum() / total)),
        "within_two": float(weights[error2 <= _TIMES**2 * stated2].sum() / total),
    }
