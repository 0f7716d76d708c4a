"""A run on a phone capture of the fox's room, scored against the known vibration.

    python -m benchmarks fox_phone RUN --truth DIR [--sensors] [--out FILE] [--no-pictures]

RUN was trained on a capture whose scene.json gives its kind (tripod, handheld or clips); DIR holds truth.json and
gauss.npz. The run's world is aligned with the truth's by the camera poses. `picture`: displacement in the tripod's
view, phasors in pixels; the run's and the true ones (at the run's Gaussians) are blended with the run's weights.
`space`: displacement in 3D, weighted by blending weight. `pictures`: SSIM of views magnified by 20 against the exact
ones.

--sensors, of a tripod: virtual sensors on the nose, the picture frame and the wall instead. The standard deviation
holds for the real and for the imaginary part of a phasor, so the error of each is given: in phase with the truth, and
in quadrature. 68 % of them should lie within one standard deviation.
"""

import argparse
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from tg4mm.capture import Capture, load_capture
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.core.magnification import Magnification
from tg4mm.core.metrics import ssim
from tg4mm.core.pictures.decode import read_png
from tg4mm.fit.gaussians import Gaussians
from tg4mm.run import Run
from tg4mm.show.maps import blending_weights
from tg4mm.show.measure import Prepared, SensorResult, measure, parse_sensor, prepare
from tg4mm.show.measure.spectrum import sinusoid_columns
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features, render_image
from tg4mm.show.render.sequence import RenderRequest, pose_of
from tg4mm.show.result.reading import pixel_rows

ALPHA, FRAMES = 20, (0, 6, 12, 18, 24)  # of the exact magnified views
COVERED = 0.5  # opacity from which a pixel counts
SEEN, NEIGHBOURS = 0.1, 4  # opacity from which a true Gaussian counts, and how many are averaged
PHASE_RAD = (0.0, 1.0)  # of the two sines at t = 0
MOVES, STILL = (
    0.5,
    0.02,
)  # of the largest true phasor: above the one things move, below the other they stand still
FOUND_HZ = 0.03  # a mode this near to a true frequency is that frequency
FALSE_PEAK = 0.1  # of the weaker true peak: from there on a mode elsewhere is a false peak
# x, y, radius in pixels of the tripod's view: the nose, the picture frame's lower edge, wallpaper that stands still
PLACES = {"nose": (302, 423, 14), "frame": (90, 192, 16), "wall": (430, 120, 40)}

OPTIONS = {
    "run": Path,
    "--truth": Path("../shared/data/fox_phone/truth"),
    "--sensors": {"action": "store_true", "help": "virtual sensors, instead of scores"},
    "--out": Path,
    "--no-pictures": {"action": "store_true", "help": "leave out the SSIM of magnified views"},
}


def run(options: argparse.Namespace) -> None:
    """Print the scores, and write them as JSON to --out; or print the table of the sensors."""
    opened, truth = Run.open(options.run), FoxTruth.load(options.truth)
    if options.sensors:
        print("\n".join(sensor_lines(prepare(opened), truth)))
        return
    figures = scored(opened, truth, not options.no_pictures)
    print("\n".join(report_lines(figures)))
    if options.out:
        write_json(options.out, figures)


@dataclass(frozen=True)
class WorldAlignment:
    """x_truth = scale · rotation x_run + shift."""

    scale: float
    rotation: np.ndarray  # [3, 3]
    shift: np.ndarray  # [3], truth's units

    def to_truth(self, xyz: np.ndarray) -> np.ndarray:
        """Points [N, 3] of the run's world in the truth's."""
        return self.scale * xyz @ self.rotation.T + self.shift

    def vectors_to_run(self, vectors: np.ndarray) -> np.ndarray:
        """Displacements [..., 3] of the truth's world in the run's."""
        return vectors @ self.rotation / self.scale

    def viewmat_of(self, c2w: np.ndarray) -> np.ndarray:
        """World-to-camera [4, 4] in the run's world of a camera-to-world [4, 4] in the truth's, OpenCV axes."""
        viewmat = np.eye(4)
        viewmat[:3, :3] = c2w[:3, :3].T @ self.rotation
        centre = (c2w[:3, 3] - self.shift) @ self.rotation / self.scale
        viewmat[:3, 3] = -viewmat[:3, :3] @ centre
        return viewmat


def similarity(run_c2w: np.ndarray, truth_c2w: np.ndarray) -> WorldAlignment:
    """The similarity that takes cameras [C, 4, 4] of a run to their true poses (camera-to-world, OpenCV axes).

    The rotation is the chordal mean of the orientations'; scale and shift fit the centres to it by least squares
    (Umeyama 1991, with the rotation known): a short path of the camera does not tilt the world.
    Raises ValueError where all centres coincide.
    """
    u, _, vt = np.linalg.svd(np.einsum("cij,ckj->ik", truth_c2w[:, :3, :3], run_c2w[:, :3, :3]))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    source, target = run_c2w[:, :3, 3], truth_c2w[:, :3, 3]
    from_mean = (source - source.mean(0)) @ rotation.T
    spread = float((from_mean**2).sum())
    if spread < 1e-12:
        raise ValueError(f"all {len(source)} cameras are at one place, which has no scale")
    scale = float((from_mean * (target - target.mean(0))).sum() / spread)
    return WorldAlignment(scale, rotation, target.mean(0) - scale * rotation @ source.mean(0))


@dataclass(frozen=True)
class FoxTruth:
    """truth.json and gauss.npz: x(t) = means + Σ_f shapes[f] sin(2π f t + phase of f + phase of the clip)."""

    folder: Path
    values: dict[str, Any]
    means: np.ndarray  # [M, 3]
    opacities: np.ndarray  # [M]
    shapes: np.ndarray  # [F, M, 3] displacement amplitudes, scene units

    @classmethod
    def load(cls, folder: Path) -> "FoxTruth":
        """Read a truth folder."""
        values = json.loads((folder / "truth.json").read_text())
        with np.load(folder / "gauss.npz") as file:
            shapes = np.stack([file["shape_3_4Hz"], file["shape_7Hz"]]).astype(np.float64)
            return cls(folder, values, file["means"].astype(np.float64), file["opacities"], shapes)

    @property
    def freqs_hz(self) -> list[float]:
        return [float(f) for f in self.values["f_hz"]]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.means[self.opacities > SEEN])

    def phasors(self, xyz: np.ndarray) -> np.ndarray:
        """[F, N, 3] complex displacement of points [N, 3] of the truth's world, of the form Re[m exp(i 2π f t)].

        Mean over the nearest truth Gaussians, weighted by inverse squared distance.
        """
        distance, index = self._tree.query(xyz, NEIGHBOURS)
        weight = 1 / (distance + 1e-9) ** 2
        weight /= weight.sum(1, keepdims=True)
        at = np.einsum("nk,fnkc->fnc", weight, self.shapes[:, self.opacities > SEEN][:, index])
        return at * (-1j * np.exp(1j * np.array(PHASE_RAD)))[:, None, None]  # sin x = Re[−i exp(ix)]

    def c2w(self, name: str, timestep: int, kind: str) -> np.ndarray | None:
        """True camera-to-world [4, 4] of a picture called `name` (without suffix); None if it is none of the set's.

        Photographs are called by their number in the sweep, fixed cameras and clips cam_00 …; all of a handheld
        video is one moving camera.
        """
        sweep = self.values["cams_sweep"]
        if kind == "handheld":
            poses, i = self.values["hand"], timestep
        elif match := re.fullmatch(r"cam_([0-9]+)", name):
            clips = [sweep[c] for c in self.values["clips"]["cams"]]
            poses, i = clips if kind == "clips" else [self.values["c2w_fixed"]], int(match[1])
        elif match := re.fullmatch(r"(?:sweep_)?([0-9]+)", name):
            poses, i = sweep, int(match[1])
        else:
            return None
        return np.array(poses[i]) if i < len(poses) else None

    def camera(self, name: str, size: tuple[int, int], world: WorldAlignment) -> Camera:
        """`c2w_fixed` or `c2w_novel` in a run's world, for pictures of this size (width, height)."""
        K = np.array(self.values["K"])
        K[0] *= size[0] / self.values["W"]
        K[1] *= size[1] / self.values["H"]
        return Camera(name, world.viewmat_of(np.array(self.values[name])), K, *size)


def world_of(capture: Capture, truth: FoxTruth) -> tuple[str, WorldAlignment, float]:
    """A capture's kind, how its world lies in the truth's by its cameras, and the rms distance left between centres.

    Pictures are matched by name and, of a handheld video, by time. Raises CaptureError for another kind, or where
    fewer than three poses are known.
    """
    kind = capture.scene.get("kind")
    if kind not in ("tripod", "handheld", "clips"):
        raise CaptureError(
            f"{capture.root / 'scene.json'}: kind is {kind!r}, expected tripod, handheld or clips"
        )
    times = np.asarray(capture.times_s) * truth.values["fps"]
    frames = np.where(np.isfinite(times), np.rint(np.nan_to_num(times)), capture.timesteps).astype(int)
    first = np.unique(capture.camera_ids, return_index=True)[1]
    known = [truth.c2w(capture.paths[i].stem, int(frames[i]), kind) for i in first]
    pairs = [
        (np.linalg.inv(capture.viewmats[i]), c2w)
        for i, c2w in zip(first, known, strict=True)
        if c2w is not None
    ]
    if len(pairs) < 3:
        raise CaptureError(f"{capture.root}: {len(pairs)} pictures have a true pose, expected at least 3")
    run_c2w, truth_c2w = (np.stack(poses) for poses in zip(*pairs, strict=True))
    world = similarity(run_c2w, truth_c2w)
    left = world.to_truth(run_c2w[:, :3, 3]) - truth_c2w[:, :3, 3]
    return kind, world, rms(left, np.ones(len(left)))


def rms(phasors: np.ndarray, weights: np.ndarray) -> float:
    """Root of the weighted mean of |phasor|², phasors [..., D] and weights [...]; 0 where no weight is."""
    total = weights.sum()
    return float(np.sqrt(((np.abs(phasors) ** 2).sum(-1) * weights).sum() / total)) if total > 0 else 0.0


def comparison(estimated: np.ndarray, true: np.ndarray, weights: np.ndarray) -> dict[str, float]:
    """Estimated phasors [..., D] against true ones, weights [...].

    Over what moves by more than half the largest true phasor: `error`, rms of the difference after the best common
    phase over rms of the truth; `amplitude_ratio` of the two rms; `phase_deg`, by how much the estimate is ahead;
    `direction_deg`, mean angle between the two as lines, by |true|², 90 where nothing moves. Over everything: `mac`,
    the modal assurance criterion (Allemang & Brown 1982). `leak`: rms of the estimate where the truth is below 2 % of
    its largest, over the true rms of what moves.
    """
    size = np.linalg.norm(true, axis=-1)
    largest = size[weights > 0].max(initial=0.0)
    moves, still = weights * (size > MOVES * largest), weights * (size < STILL * largest)
    across = (true.conj() * estimated).sum(-1)
    phase = float(np.angle((across * moves).sum()))
    true2, estimated2 = size**2, (np.abs(estimated) ** 2).sum(-1)
    seen, direction = (moves * true2 > 0) & (estimated2 > 0), 90.0
    if seen.any():
        cosine = np.minimum(np.abs(across)[seen] / np.sqrt(estimated2 * true2)[seen], 1.0)
        direction = float(np.degrees(np.average(np.arccos(cosine), weights=(moves * true2)[seen])))
    norms = float((weights * true2).sum() * (weights * estimated2).sum())
    unit = rms(true, moves) or np.nan
    return {
        "error": rms(estimated * np.exp(-1j * phase) - true, moves) / unit,
        "amplitude_ratio": rms(estimated, moves) / unit,
        "phase_deg": float(np.degrees(phase)),
        "direction_deg": direction,
        "mac": float(abs((across * weights).sum()) ** 2) / norms if norms > 0 else 0.0,
        "leak": rms(estimated, still) / unit,
    }


@dataclass(frozen=True)
class ScoredRun:
    """A run with all that is scored: the Gaussians, the modes, and where the truth's cameras are in its world."""

    run: Run
    kind: str
    gaussians: Gaussians
    weights: np.ndarray  # [N], blending weights
    freqs_hz: np.ndarray  # [K]
    modes: np.ndarray  # [K, N, 3] complex displacement
    true: np.ndarray  # [F, N, 3], the exact one, in the run's world
    duration_s: float
    world: WorldAlignment
    camera: Camera  # the tripod's view, in the run's world

    def flow_map(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Phasors of pixels [H, W, 2] from Gaussians' displacements [N, 3] complex, and which pixels count [H, W]."""
        camera, means = self.camera, self.gaussians.means.numpy().astype(np.float64)
        derivative = pixel_rows(means, camera.viewmat, camera.K, (camera.width, camera.height))[0]
        flow = np.einsum("nij,nj->ni", derivative, vectors)
        features, opacity = render_features(self.gaussians, np.concatenate([flow.real, flow.imag], 1), camera)
        return features[..., :2] + 1j * features[..., 2:], (opacity > COVERED).astype(np.float64)

    def phasor_at(self, frequency: float) -> np.ndarray:
        """[N, 3] complex: what the modes near a frequency do there together; 0 where there is none.

        A mode beside the frequency counts by its mean over the capture, once the two turn with each other: modes that
        beat add up to what is seen.
        """
        near = np.flatnonzero(np.abs(self.freqs_hz - frequency) <= FOUND_HZ)
        turns = (self.freqs_hz[near] - frequency) * self.duration_s
        return np.tensordot(np.exp(1j * np.pi * turns) * np.sinc(turns), self.modes[near], 1)


def load_subject(run: Run, truth: FoxTruth) -> tuple[ScoredRun, float]:
    """The run, and the rms distance of its camera centres from the true ones.

    Raises Tg4mmError where the run has no motion or its cameras no true pose.
    """
    capture, motion = load_capture(run.dataset), run.load_motion()
    if motion is None:
        raise Tg4mmError(f"{run.path} has no motion to score")
    kind, world, left = world_of(capture, truth)
    size = capture.width, capture.height
    camera = truth.camera("c2w_fixed", size, world)
    if kind == "tripod":  # the run's own: pixels lie upon each other whatever the SfM found
        i = np.flatnonzero(capture.camera_ids == np.bincount(capture.camera_ids).argmax())[0]
        camera = Camera("c2w_fixed", capture.viewmats[i], capture.Ks[i], *size)
    gaussians = run.load_space()
    true = world.vectors_to_run(truth.phasors(world.to_truth(gaussians.means.numpy().astype(np.float64))))
    weights, duration_s = blending_weights(gaussians, capture), motion.n_timesteps / motion.fps
    return ScoredRun(
        run, kind, gaussians, weights, motion.freqs_hz, motion.displacement, true, duration_s, world, camera
    ), left  # fmt: skip


def largest_px(flow: np.ndarray, counts: np.ndarray) -> float:
    """99.9th percentile over pixels of the phasors' length: the amplitude of what moves most, not of one pixel."""
    lengths = np.linalg.norm(flow, axis=-1)[counts > 0]
    return float(np.quantile(lengths, 0.999)) if len(lengths) else 0.0


def scored(run: Run, truth: FoxTruth, pictures: bool = True) -> dict[str, Any]:
    """All figures of a run. Raises Tg4mmError where it has none to score."""
    subject, left = load_subject(run, truth)
    modes: list[dict[str, float]] = []
    rows: list[dict[str, Any]] = []
    for frequency, vectors in zip(subject.freqs_hz.tolist(), subject.modes, strict=True):
        px = largest_px(*subject.flow_map(vectors))
        modes.append({"frequency_hz": frequency, "rms": rms(vectors, subject.weights), "amplitude_px": px})
    for frequency, true in zip(truth.freqs_hz, subject.true, strict=True):
        found = subject.phasor_at(frequency)
        (flow, counts), (exact, _) = subject.flow_map(found), subject.flow_map(true)
        nearest = float(subject.freqs_hz[np.abs(subject.freqs_hz - frequency).argmin()])
        rows.append(
            {
                "true_hz": frequency,
                "nearest_hz": nearest,
                "found": abs(nearest - frequency) <= FOUND_HZ,
                "true_px": largest_px(exact, counts),
                "amplitude_px": largest_px(flow, counts),
                "picture": comparison(flow, exact, counts),
                "space": comparison(found, true, subject.weights),
            }
        )
    least = FALSE_PEAK * min(row["true_px"] for row in rows)
    far = [m for m in modes if np.abs(m["frequency_hz"] - np.array(truth.freqs_hz)).min() > FOUND_HZ]
    false = [m for m in far if m["amplitude_px"] > least and m["frequency_hz"] > 0]
    figures: dict[str, Any] = {
        "run": str(run.path), "kind": subject.kind, "n_gaussians": len(subject.gaussians),
        "scale": subject.world.scale, "camera_rms": left, "modes": modes, "frequencies": rows,
        "false_peaks": sorted(false, key=lambda mode: -mode["amplitude_px"]),
    }  # fmt: skip
    if phases := run.log().get("motion", {}).get("clip_phases_deg"):
        figures["clip_phases"] = clip_phase_errors(phases, truth)
    if pictures and subject.kind != "clips":  # clips start with a phase of their own
        figures["pictures"] = picture_scores(subject, truth)
    return figures


def clip_phase_errors(found: dict[str, dict[str, Any]], truth: FoxTruth) -> list[dict[str, Any]]:
    """Errors of the clips' phases, found[camera][frequency in Hz] in degrees, for every true frequency found there.

    Clip c is ahead by phases[c] at the first frequency and by phases[c] · f / f₁ at another. Errors are those after the
    best common phase, which the clips' own gauge leaves open.
    """
    rows = []
    for frequency in truth.freqs_hz:
        turned = {}
        for name, by_frequency in sorted(found.items()):
            nearest = min(by_frequency, key=lambda f: abs(float(f) - frequency), default="inf")
            if abs(float(nearest) - frequency) <= FOUND_HZ:
                phase = truth.values["clips"]["phases"][int(name.rpartition("_")[2])]
                ahead = np.radians(float(by_frequency[nearest])) - phase * frequency / truth.freqs_hz[0]
                turned[name] = np.exp(1j * ahead)
        common = np.conj(sum(turned.values()))
        errors = {name: float(np.degrees(np.angle(turn * common))) for name, turn in turned.items()}
        if errors:
            rows.append({"frequency_hz": frequency, "errors_deg": errors})
    return rows


def picture_scores(subject: ScoredRun, truth: FoxTruth) -> dict[str, dict[str, float]]:
    """SSIM at α = 20 of the tripod's and another view, mean over frames, and of each that there is to compare with.

    `run`, every mode magnified; `nothing_moves`; `truth_moved`, the exact motion on the same Gaussians: the ceiling.
    """
    magnified, _, fps = pose_of(subject.run, RenderRequest(Magnification.of(ALPHA)))
    rest = subject.gaussians

    def truth_moved(t: float) -> Gaussians:
        turns = np.exp(2j * np.pi * np.array(truth.freqs_hz) * t / fps)
        moved = (1 + ALPHA) * np.tensordot(turns, subject.true, 1).real
        return replace(rest, means=rest.means + torch.from_numpy(moved).float())

    def mean_ssim(view: str, camera: Camera, pose: Callable[[float], Gaussians]) -> float:
        values = []
        for t in FRAMES:
            exact = read_png(truth.folder / f"x{ALPHA:03d}_{view}_{t:03d}.png") / 255.0
            side = exact.shape[1] // camera.width  # area means, at the run's size
            blocks = exact.reshape(exact.shape[0] // side, side, camera.width, side, 3)
            image = render_image(pose(float(t)), camera.viewmat, camera.K, camera.width, camera.height)
            values.append(ssim(image, blocks.mean((1, 3)).astype(np.float32)))
        return float(np.mean(values))

    poses: dict[str, Callable[[float], Gaussians]] = {
        "run": magnified, "nothing_moves": lambda t: rest, "truth_moved": truth_moved,
    }  # fmt: skip
    novel = truth.camera("c2w_novel", (subject.camera.width, subject.camera.height), subject.world)
    return {
        view: {name: mean_ssim(view, camera, pose) for name, pose in poses.items()}
        for view, camera in (("fixed", subject.camera), ("novel", novel))
    }


def report_lines(figures: dict[str, Any]) -> Iterator[str]:
    """The figures as text."""
    yield (
        f"{figures['run']}: {figures['kind']}, {figures['n_gaussians']} Gaussians, scale {figures['scale']:.4f}, "
        f"cameras {figures['camera_rms']:.2g} units off"
    )
    for mode in sorted(figures["modes"], key=lambda mode: -mode["amplitude_px"])[:12]:
        size = f"rms {mode['rms']:.2e} units, largest {mode['amplitude_px']:.3f} px"
        yield f"  mode {mode['frequency_hz']:7.3f} Hz  {size}"
    for row in figures["frequencies"]:
        state = "found" if row["found"] else "NOT FOUND"
        sizes = f"largest {row['amplitude_px']:.3f} px, truth {row['true_px']:.3f} px"
        yield f"{row['true_hz']:g} Hz: {state}, nearest {row['nearest_hz']:.3f} Hz, {sizes}"
        for name in ("picture", "space"):
            yield f"  {name:10}" + "  ".join(f"{k} {v:.4g}" for k, v in row[name].items())
    wrong = [f"{p['frequency_hz']:.3f} Hz ({p['amplitude_px']:.3f} px)" for p in figures["false_peaks"]]
    yield f"false peaks: {', '.join(wrong) or 'none'}"
    for row in figures.get("clip_phases", []):
        errors = "  ".join(f"{name} {error:+.1f}" for name, error in row["errors_deg"].items())
        yield f"clips' phases at {row['frequency_hz']:g} Hz, errors in degrees: {errors}"
    for view, values in figures.get("pictures", {}).items():
        yield f"SSIM ×{ALPHA} {view}: " + "  ".join(f"{k} {v:.4f}" for k, v in values.items())


def sensor_lines(scene: Prepared, truth: FoxTruth) -> Iterator[str]:
    """The table of virtual sensors. Raises Tg4mmError for a capture that is not of a tripod."""
    kind, world, _ = world_of(scene.capture, truth)
    if kind != "tripod":
        raise Tg4mmError(f"--sensors is for a tripod's capture, not {kind}")
    sensors = [
        parse_sensor(f"{name}=pixel:cam_00,{x},{y},{radius}") for name, (x, y, radius) in PLACES.items()
    ]
    ratios: list[float] = []
    yield "sensor        Hz axis            found, px  truth, px   phase, °  in phase in quadrature"
    for result in measure(scene, sensors).sensors:
        yield from _sensor_rows(result, scene, truth, world, ratios)
    known = np.array([ratio for ratio in ratios if np.isfinite(ratio)])
    within = ", ".join(f"{np.mean(known < k):.0%} within {k}" for k in (1, 2, 3))
    yield f"\n{len(known)} parts of phasors, errors by deviations: {within} (68%, 95%, 99.7% expected)"


def _sensor_rows(
    result: SensorResult, scene: Prepared, truth: FoxTruth, world: WorldAlignment, ratios: list[float]
) -> Iterator[str]:
    """Lines of one sensor; adds the errors of both parts of each phasor over their deviation to `ratios`."""
    rows = np.flatnonzero(result.body.weights)
    weights = (result.body.weights * scene.seen)[rows]
    phasors = truth.phasors(world.to_truth(scene.means[rows]))
    mean = world.vectors_to_run(np.einsum("n,fnc->fc", weights / weights.sum(), phasors))
    hz = np.array(truth.freqs_hz)
    true = mean @ result.axes.T * result.px_per_unit
    design = np.linalg.pinv(sinusoid_columns(hz, result.times_s)) @ result.displacement
    found = (design[1 : 1 + len(hz)] + 1j * design[1 + len(hz) :]) * result.px_per_unit
    noise = result.series.noise[0] * np.sqrt(2 / len(result.times_s)) * result.px_per_unit
    size = np.linalg.norm(found[:, result.series.is_resolved], axis=1)
    deviation = np.hypot(noise, result.series.model_share * size[:, None])
    for f, k in np.ndindex(*true.shape):
        moves, one = abs(true[f, k]) > 1e-9, deviation[f, k]
        turned = found[f, k] * (np.exp(-1j * np.angle(true[f, k])) if moves else 1.0)
        off = turned - abs(true[f, k])
        by = np.abs([off.real, off.imag]) / (one if np.isfinite(one) and one > 0 else np.nan)
        ratios += by.tolist()
        phase = f"{np.degrees(np.angle(turned)):.1f}" if moves else "–"
        yield (
            f"{result.name:<10} {hz[f]:5.2f} {result.labels[k]:<6} {abs(turned):9.4f} ± {one:6.4f} "
            f"{abs(true[f, k]):10.4f} {phase:>10} {by[0]:7.2f} σ {by[1]:11.2f} σ"
        )
