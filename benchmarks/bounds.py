"""Error of the motion of runs on generated sets, relative to the smallest error that their pictures allow.

    tg4mm generate NAME --out data; tg4mm train data/SET --out RUN; tg4mm evaluate RUN --alphas 20
    python -m benchmarks bounds RUN…

The bound is the error of weighted least squares in a basis of smooth functions: 20 or 50 control points that shift, or
12 that move affinely; the best of the three. It has the run's Gaussians and their Jacobian, the noise that the pictures
show at other courses of time than the motion's, and what the basis misses of the exact motion. No fit knows these, so
that it is a bound for such bases, not for every method. "Parts known" is the same for the first mode, where every
object of the ground truth moves affinely: what remains if a method knows which Gaussians move together.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.capture.truth_file import Truth, load_truth
from tg4mm.fit.gaussians import Gaussians, rotation_matrices
from tg4mm.fit.motion.animate import displacement_at, rotation_at
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.prior import NeighbourGraph, build_graph
from tg4mm.research.evaluate.displacement import (
    STATIC_BELOW,
    displacement_figures,
    exact_motion,
    mean_squares,
    sample_surface,
)
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.show.maps import blending_weights

OPTIONS: dict[str, Any] = {"runs": {"nargs": "+", "type": Path, "metavar": "RUN"}}
_HEAD = ("set", "error, %", "ratio", "leak, %", "closure", "within 2 ±, all/moving, %", "noise, %", "bound, %",
         "parts known, %")  # fmt: skip
BASES = ((20, False), (50, False), (12, True))  # control points, and whether they move affinely
_WIDTH = 0.8  # of the median distance of control points: standard deviation of their influence
_SMOOTHING_PX = 1.5
_OF_TRUTH = 0.01  # of the motion's energy: what a function of time holds at least
_PICKED = 20_000  # Gaussians that control points are placed by
_AT_ONCE = 8  # fields


@dataclass(frozen=True)
class BoundedRun:
    """A run's Gaussians, with the exact motion and the pictures' changes at its courses of time."""

    gaussians: Gaussians
    weights: np.ndarray  # [N], blending weights
    exact: ModalMotion
    views: list[ViewJacobian]
    fields: np.ndarray  # [L, N, 6], the exact motion at its L courses
    variances: np.ndarray  # [V, H, W], noise of a picture at one course

    @staticmethod
    def of(run: Run, capture: Capture) -> "BoundedRun":
        gaussians = run.load_space()
        truth = load_truth(run.dataset, capture.fps, capture.n_timesteps)
        exact = exact_motion(truth, gaussians.means.numpy())
        weights = blending_weights(gaussians, capture)
        images = load_images(capture)
        frames = observe(capture, images).frames
        size = (capture.width, capture.height)
        views = [view_jacobian(gaussians, f, size) for f in frames]
        courses, fields = _courses(exact, weights, capture.n_timesteps)
        pictures = np.array([[images.rgb(int(r)) for r in f.rows] for f in frames], np.float32)
        return BoundedRun(gaussians, weights, exact, views, fields, _noise(pictures, courses))


def run(options: Any) -> None:
    """Prints a row for each run."""
    print(f"| {' | '.join(_HEAD)} |\n|:--{'|--:' * (len(_HEAD) - 1)}|")
    for path in options.runs:
        print(f"| {(run := Run.open(path)).dataset.name} | {' | '.join(_cells(run))} |", flush=True)


def _cells(run: Run) -> Iterator[str]:
    capture = load_capture(run.dataset, split="train")
    subject, found = BoundedRun.of(run, capture), run.load_motion()
    if found is None:
        raise ValueError(f"{run.path} has no motion")
    found = found.selected(found.freqs_hz > 0)
    figures = displacement_figures(found, subject.exact, subject.weights)
    main = max(figures["per_frequency"], key=lambda row: row["amplitude_true"])
    yield f"{100 * figures['relative_error']:.1f}"
    yield f"{main['amplitude_ratio'] or 0:.2f}"
    yield f"{100 * (figures['static_leak'] or 0):.0f}"
    scores = (run.path / "metrics.json", run.path.parent / "metrics_modal.json")  # of evaluate, and of bench
    yield next((_closure(file) for file in scores if file.is_file()), "–")
    yield _within(run, found, subject)
    means, axes = subject.gaussians.means.numpy(), rotation_matrices(subject.gaussians.quats).numpy()
    graph = build_graph(means, axes, subject.gaussians.scales.numpy())
    smooth = (bound_of(subject, basis_fields(means, subject.weights, graph, *basis)) for basis in BASES)
    first = subject.exact.selected(subject.exact.freqs_hz == main["frequency_hz"])
    _, fields = _courses(first, subject.weights, capture.n_timesteps)
    parts = part_fields(load_truth(run.dataset, capture.fps, capture.n_timesteps), means)
    known = bound_of(replace(subject, exact=first, fields=fields), parts)[1]
    shares = *min(smooth, key=lambda pair: pair[1]), known
    yield from (f"{100 * share:.0f}" for share in shares)


def _closure(file: Path) -> str:
    """Return the closure at the largest α that was scored."""
    value = max(json.loads(file.read_text())["alphas"], key=lambda entry: entry["alpha"])["closure"]
    return "–" if value is None else f"{value:.2f}"


def _within(run: Run, found: ModalMotion, subject: BoundedRun) -> str:
    part, _ = run.load_part(UNCERTAINTY)
    if not part:
        return "–"
    error, true, _ = mean_squares(found, subject.exact)
    is_within = error <= 4 * part["displacement"].numpy().astype(np.float64) ** 2
    moves = true > STATIC_BELOW**2 * true.max()
    shares = [np.average(is_within[k], weights=subject.weights[k]) for k in (slice(None), moves)]
    return "/".join(f"{100 * share:.0f}" for share in shares)


def bound_of(subject: BoundedRun, basis: np.ndarray) -> tuple[float, float]:
    """Relative error of least squares in a basis: by noise alone, and with what the basis misses and a ridge draws in.

    The ridge has the exact motion's own power, as the best linear estimate of coefficients of that power has.
    """
    information, of_noise = _information(subject, basis)
    u, w, true = basis[..., :3], subject.weights, subject.fields[..., :3]
    weighted = (u * np.sqrt(w)[:, None]).reshape(len(u), -1)
    gram = (weighted @ weighted.T).astype(np.float64)
    power = float(np.einsum("lnc,lnc,n->", true, true, w))
    along = np.einsum("pnc,lnc,n->pl", u, true, w, optimize=True)
    p = len(gram)
    coefficients = np.linalg.solve(gram + 1e-9 * np.trace(gram) / p * np.eye(p), along)
    missed = (
        power - 2 * (coefficients * along).sum() + np.einsum("pl,pq,ql->", coefficients, gram, coefficients)
    )
    scale = float(subject.variances[subject.variances > 0].mean())
    ridge = 2 * scale * np.trace(gram) / (power / len(true))
    inverse = np.linalg.inv(information + ridge * np.eye(p))
    noise = len(true) * np.trace(inverse @ of_noise @ inverse @ gram)
    drawn = (inverse @ information - np.eye(p)) @ coefficients
    bias = np.einsum("pl,pq,ql->", drawn, gram, drawn)
    return float(np.sqrt(noise / power)), float(np.sqrt((noise + bias + max(missed, 0)) / power))


def _information(subject: BoundedRun, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bᵀ JᵀWJ B of fields B [P, N, 6], and Bᵀ JᵀW Σ WJ B with the variances Σ of pixels; [P, P] each."""
    scale = subject.variances[subject.variances > 0].mean()
    out = np.zeros((2, len(basis), len(basis)))
    for view, variance in zip(subject.views, subject.variances, strict=True):
        weight = np.repeat((1 / (1 + variance / scale)).ravel(), 3)
        some = (basis[k : k + _AT_ONCE] for k in range(0, len(basis), _AT_ONCE))
        shown = np.concatenate([view.jvp(np.ascontiguousarray(b)).reshape(len(b), -1) for b in some])
        changed = shown.any(0)
        shown, weight = shown[:, changed], weight[changed].astype(np.float32)
        weighted = shown * weight
        out[0] += weighted @ shown.T
        weighted *= np.sqrt(np.repeat(variance.ravel(), 3)[changed], dtype=np.float32)
        out[1] += weighted @ weighted.T
    return out[0], out[1]


def basis_fields(
    means: np.ndarray, weights: np.ndarray, graph: NeighbourGraph, n_points: int, is_affine: bool
) -> np.ndarray:
    """[P, N, 6] float32: motions of Gaussians at `means` [N, 3] that follow control points.

    The points are placed by `weights` [N]; a Gaussian follows each by a normal influence, all together one.
    """
    x = means.astype(np.float64)
    picked = np.random.default_rng(0).choice(len(x), _PICKED, p=weights / weights.sum())
    points, _ = kmeans2(x[picked], n_points, minit="++", seed=0)
    radius = _WIDTH * float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))
    away = x[:, None] - points
    exponent = -(away**2).sum(-1) / (2 * radius**2)
    influence = np.exp(exponent - exponent.max(1, keepdims=True))
    influence /= influence.sum(1, keepdims=True)
    slope = -away / radius**2
    slope = influence[..., None] * (slope - (influence[..., None] * slope).sum(1, keepdims=True))
    out = []
    for k in range(n_points):
        parts = [(influence[:, k], slope[:, k])]
        for a in range(3) if is_affine else ():
            lever = away[:, k, a] / radius
            gradient = slope[:, k] * lever[:, None]
            gradient[:, a] += influence[:, k] / radius
            parts.append((influence[:, k] * lever, gradient))
        out += [_moved(graph, value, gradient, axis) for value, gradient in parts for axis in range(3)]
    return np.stack(out)


def part_fields(truth: Truth, means: np.ndarray) -> np.ndarray:
    """[P, N, 6] float32: affine motions of one object of the truth each; of no object without a Gaussian near it."""
    bodies = [sample_surface(o.rest, o.faces, _PICKED // 4) for o in truth.objects if len(o.rest)]
    nearest = np.argmin([body.tree.query(means)[0] for body in bodies], 0)
    out = []
    for part in np.unique(nearest):
        mine = np.flatnonzero(nearest == part)
        x = means[mine] - means[mine].mean(0)
        x /= (scale := float(np.abs(x).max()) or 1.0)
        levers = np.concatenate([np.ones((len(x), 1)), x], 1)
        turns = np.cross(np.eye(4, 3, k=-1)[:, None], np.eye(3)) / 2 / scale  # half the curl
        field = np.zeros((4, 3, len(means), DOF), np.float32)
        field[:, :, mine, :3] = np.einsum("na,ij->aijn", levers, np.eye(3)).swapaxes(2, 3)
        field[:, :, mine, 3:] = turns[:, :, None]
        out.append(field.reshape(12, len(means), DOF))
    return np.concatenate(out)


def _moved(graph: NeighbourGraph, value: np.ndarray, gradient: np.ndarray, axis: int) -> np.ndarray:
    """[N, 6]: displacement `value` [N] along an axis, with its gradient [N, 3]."""
    field = np.zeros((len(value), 4, 3), np.float32)
    field[:, 0, axis] = value
    field[:, 1:, axis] = gradient * graph.mean_spacing
    return graph.motion(field.reshape(-1, 3))


def _courses(exact: ModalMotion, weights: np.ndarray, n_timesteps: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal courses [L, T] of time of the exact motion, mean-free, and the motion at each, [L, N, 6]."""
    times = range(n_timesteps)
    series = np.stack([np.concatenate([displacement_at(exact, t), rotation_at(exact, t)], 1) for t in times])
    series -= series.mean(0)
    seen = (series[..., :3] * np.sqrt(weights)[:, None]).reshape(n_timesteps, -1).astype(np.float64)
    energy, vectors = np.linalg.eigh(seen @ seen.T)
    courses = vectors[:, energy > _OF_TRUTH * energy.sum()].T
    return courses, np.tensordot(courses, series, 1).astype(np.float32).reshape(len(courses), -1, DOF)


def _noise(pictures: np.ndarray, courses: np.ndarray) -> np.ndarray:
    """[V, H, W]: variance of one channel of a picture at one course of time, from pictures [V, T, H, W, 3]."""
    changes = pictures - pictures.mean(1, keepdims=True)
    changes -= np.einsum("lt,vlhwc->vthwc", courses, np.einsum("lt,vthwc->vlhwc", courses, changes))
    flat = np.moveaxis(changes, 1, 0).reshape(changes.shape[1], -1)
    energy = np.linalg.eigvalsh(flat @ flat.T)
    freedom = max(int((energy > 1e-4 * energy[-1]).sum()), 1)
    variance = np.einsum("vthwc,vthwc->vhw", changes, changes) / (3 * freedom)
    return np.asarray(gaussian_filter(variance, (0, _SMOOTHING_PX, _SMOOTHING_PX)))
