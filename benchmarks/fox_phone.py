"""A run on one of the phone captures of the fox's room, scored against the known vibration.

    python -m benchmarks fox_phone RUN --truth DIR [--scene RUN] [--out FILE] [--no-pictures]

RUN was trained on a capture whose scene.json says its kind (tripod, handheld, clips, flat); DIR holds truth.json and
gauss.npz. The run's world is aligned with the truth's by the cameras' poses. `picture`: displacement in the tripod's
view, phasors of pixels, the run's and the truth's (taken at the run's Gaussians) blended by the run's weights.
`picture_apart`: against the truth on other Gaussians, in which the run's geometry has no part; of a flat capture the
only one. Those are the rest scene of the run `--scene`, trained with true poses, or else round splats at the truth's
means, which themselves are off by a tenth to a fifth. `space`: displacement in space, weighted by blending weight in
the capture's pictures. `pictures`: SSIM of views magnified by 20 against the exact ones.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import fox_phone_scores as scores
from benchmarks.fox_phone_truth import IDENTITY, Similarity, Truth, kind_of, world_of
from tg4mm.capture import Capture, load_capture
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import write_json
from tg4mm.core.magnification import Magnification
from tg4mm.core.metrics import ssim
from tg4mm.core.pictures.frames import read_png
from tg4mm.fit.gaussians import Gaussians
from tg4mm.run import Run
from tg4mm.show.maps import blending_weights
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_features, render_image
from tg4mm.show.render.sequence import RenderRequest, pose_of

ALPHA = 20
FRAMES = (0, 6, 12, 18, 24)
BAND = (3.0, 7.5)  # Hz: both true frequencies
COVERED = 0.5  # opacity from which a pixel counts


@dataclass(frozen=True)
class Subject:
    """A run with all that is scored: the Gaussians, the modes, and where the truth's cameras are in its world."""

    run: Run
    capture: Capture
    kind: str
    gaussians: Gaussians
    freqs_hz: np.ndarray  # [K]
    modes: np.ndarray  # [K, N, 3] complex displacement
    duration_s: float
    world: Similarity
    camera: Camera  # the tripod's view, in the run's world

    @property
    def means(self) -> np.ndarray:
        return self.gaussians.means.numpy().astype(np.float64)


def load_subject(run: Run, truth: Truth) -> tuple[Subject, float | None]:
    """The run, and the rms distance of its camera centres from the true ones (None for a flat capture).

    Raises Tg4mmError where the run has no motion or its cameras no true pose.
    """
    capture = load_capture(run.dataset)
    kind = kind_of(capture)
    motion = run.load_motion()
    if motion is None:
        raise Tg4mmError(f"{run.path} has no motion to score")
    world, left = (IDENTITY, None) if kind == "flat" else world_of(capture, truth)
    size = capture.width, capture.height
    fixed = np.bincount(capture.camera_ids).argmax()
    i = int(np.flatnonzero(capture.camera_ids == fixed)[0])
    camera = truth.camera("c2w_fixed", size, world)
    if kind in ("tripod", "flat"):  # the run's own: pixels lie upon each other whatever the SfM found
        camera = Camera("c2w_fixed", capture.viewmats[i], capture.Ks[i], *size)
    duration_s = motion.n_timesteps / motion.fps
    modes, gaussians = np.asarray(motion.displacement), run.load_space()
    return Subject(run, capture, kind, gaussians, motion.freqs_hz, modes, duration_s, world, camera), left


def flow_map(gaussians: Gaussians, vectors: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Phasors of pixels [H, W, 2] from Gaussians' displacements [N, 3] complex, and which pixels count [H, W]."""
    flow = scores.picture_flow(gaussians.means.numpy().astype(np.float64), vectors, camera.viewmat, camera.K)
    features, opacity = render_features(gaussians, np.concatenate([flow.real, flow.imag], 1), camera)
    return features[..., :2] + 1j * features[..., 2:], (opacity > COVERED).astype(np.float64)


def largest_px(flow: np.ndarray, counts: np.ndarray) -> float:
    """99.9th percentile over pixels of the phasors' length: the amplitude of what moves most, not of one pixel."""
    lengths = np.linalg.norm(flow, axis=-1)[counts > 0]
    return float(np.quantile(lengths, 0.999)) if len(lengths) else 0.0


def exact_maps(
    truth: Truth, size: tuple[int, int], scene: Gaussians | None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each true frequency the tripod's view of it, as `flow_map`, on `scene` or on the truth's own means."""
    camera = truth.camera("c2w_fixed", size, IDENTITY)
    if scene is not None:
        return [flow_map(scene, vectors, camera) for vectors in truth.phasors(scene.means.numpy())]
    splats = truth.splats()
    return [flow_map(splats, shape * truth.turn(f), camera) for f, shape in enumerate(truth.shapes)]


def frequency_scores(subject: Subject, truth: Truth, scene: Gaussians | None) -> list[dict[str, Any]]:
    """For each true frequency: the mode nearest to it and the comparisons in the picture and in space."""
    flat = subject.kind == "flat"
    true = None if flat else truth.phasors(subject.world.to_truth(subject.means))
    weights = blending_weights(subject.gaussians, subject.capture)
    apart = exact_maps(truth, (subject.camera.width, subject.camera.height), scene)
    rows = []
    for f, frequency in enumerate(truth.freqs_hz):
        found = scores.phasor_at(subject.freqs_hz, subject.modes, frequency, subject.duration_s)
        flow, counts = flow_map(subject.gaussians, found, subject.camera)
        exact, exact_counts = apart[f]
        nearest = subject.freqs_hz[np.abs(subject.freqs_hz - frequency).argmin()]
        row: dict[str, Any] = {
            "true_hz": frequency,
            "nearest_hz": float(nearest),
            "found": bool(abs(nearest - frequency) <= scores.FOUND_HZ),
            "true_px": largest_px(exact, exact_counts),
            "amplitude_px": largest_px(flow, counts),
            "picture_apart": scores.comparison(flow, exact, counts * exact_counts),
        }
        if true is not None:
            vectors = subject.world.vectors_to_run(true[f])
            at_run, _ = flow_map(subject.gaussians, vectors, subject.camera)
            row["picture"] = scores.comparison(flow, at_run, counts)
            row["yardstick"] = scores.comparison(at_run, exact, counts * exact_counts)["error"]
            row["space"] = scores.comparison(found, vectors, weights)
        rows.append(row)
    return rows


def mode_rows(subject: Subject) -> list[dict[str, float]]:
    """Every mode: frequency, rms displacement by blending weight (scene units), and amplitude in the picture."""
    weights = blending_weights(subject.gaussians, subject.capture)
    rows = []
    for frequency, vectors in zip(subject.freqs_hz, subject.modes, strict=True):
        flow, counts = flow_map(subject.gaussians, vectors, subject.camera)
        rows.append(
            {
                "frequency_hz": float(frequency),
                "rms": scores.rms(vectors, weights),
                "amplitude_px": largest_px(flow, counts),
                "rms_px": scores.rms(flow, counts),
            }
        )
    return rows


def picture_scores(subject: Subject, truth: Truth) -> dict[str, dict[str, float]]:
    """SSIM at α = 20 of the tripod's and another view, mean over frames, and of each that there is to compare with.

    `run`, every mode magnified; `run_band`, those of 3 to 7.5 Hz; `nothing_moves`; `truth_moved`, the exact motion
    on the same Gaussians: the ceiling.
    """
    magnified, _, fps = pose_of(subject.run, RenderRequest(Magnification.of(ALPHA)))
    in_band, _, _ = pose_of(subject.run, RenderRequest(Magnification.of(ALPHA, BAND)))
    rest = subject.gaussians
    vectors = subject.world.vectors_to_run(truth.phasors(subject.world.to_truth(subject.means)))

    def truth_moved(t: float) -> Gaussians:
        turns = np.exp(2j * np.pi * np.array(truth.freqs_hz) * t / fps)
        moved = (1 + ALPHA) * np.tensordot(turns, vectors, 1).real
        means = rest.means + torch.from_numpy(moved).float()
        return Gaussians(means, rest.quats, rest.scales, rest.opacities, rest.sh)

    poses: dict[str, Callable[[float], Gaussians]] = {
        "run": magnified, "run_band": in_band, "nothing_moves": lambda t: rest, "truth_moved": truth_moved,
    }  # fmt: skip
    size = subject.camera.width, subject.camera.height
    views = {"fixed": subject.camera, "novel": truth.camera("c2w_novel", size, subject.world)}
    return {
        view: {name: _mean_ssim(truth.folder, view, camera, pose) for name, pose in poses.items()}
        for view, camera in views.items()
    }


def _mean_ssim(folder: Path, view: str, camera: Camera, pose: Callable[[float], Gaussians]) -> float:
    values = []
    for t in FRAMES:
        exact = reduced(read_png(folder / f"x{ALPHA:03d}_{view}_{t:03d}.png") / 255.0, camera.width)
        image = render_image(pose(float(t)), camera.viewmat, camera.K, camera.width, camera.height)
        values.append(ssim(image, exact))
    return float(np.mean(values))


def reduced(picture: np.ndarray, width: int) -> np.ndarray:
    """Area means of a picture [H, W, 3] at a width that divides W, [H · width / W, width, 3] float32."""
    side = picture.shape[1] // width
    blocks = picture.reshape(picture.shape[0] // side, side, width, side, 3)
    return blocks.mean((1, 3)).astype(np.float32)


def scored(run: Run, truth: Truth, scene: Gaussians | None = None, pictures: bool = True) -> dict[str, Any]:
    """All figures of a run. Raises Tg4mmError where it has none to score."""
    subject, left = load_subject(run, truth)
    modes, rows = mode_rows(subject), frequency_scores(subject, truth, scene)
    amplitudes = np.array([mode["amplitude_px"] for mode in modes])
    weakest = min(row["true_px"] for row in rows)
    figures: dict[str, Any] = {
        "run": str(run.path), "kind": subject.kind, "n_gaussians": len(subject.gaussians),
        "scale": subject.world.scale, "camera_rms": left, "modes": modes, "frequencies": rows,
        "false_peaks": scores.false_peaks(subject.freqs_hz, amplitudes, truth.freqs_hz, weakest),
    }  # fmt: skip
    phases = run.log().get("motion", {}).get("clip_phases_deg")
    if phases:
        figures["clip_phases"] = scores.clip_phase_figures(phases, truth.values)
    if pictures and subject.kind in ("tripod", "handheld"):  # clips start with a phase of their own
        figures["pictures"] = picture_scores(subject, truth)
    return figures


OPTIONS = {
    "run": Path,
    "--truth": Path("../shared/data/fox_phone/truth"),
    "--scene": {"type": Path, "help": "a run with true poses, whose rest scene carries the truth"},
    "--out": Path,
    "--no-pictures": {"action": "store_true", "help": "leave out the SSIM of magnified views"},
}


def run(options: argparse.Namespace) -> None:
    """Score, print, and write JSON where asked to."""
    scene = Run.open(options.scene).load_space() if options.scene else None
    figures = scored(Run.open(options.run), Truth.load(options.truth), scene, not options.no_pictures)
    print(report(figures))
    if options.out:
        write_json(options.out, figures)


def report(figures: dict[str, Any]) -> str:
    """The figures as text."""
    left = figures["camera_rms"]
    aligned = "" if left is None else f", scale {figures['scale']:.4f}, cameras {left:.2g} units off"
    lines = [f"{figures['run']}: {figures['kind']}, {figures['n_gaussians']} Gaussians{aligned}"]
    for mode in sorted(figures["modes"], key=lambda mode: -mode["amplitude_px"])[:12]:
        lines.append(
            f"  mode {mode['frequency_hz']:7.3f} Hz  rms {mode['rms']:.2e} units {mode['rms_px']:.4f} px, "
            f"largest {mode['amplitude_px']:.3f} px"
        )
    for row in figures["frequencies"]:
        state = "found" if row["found"] else "NOT FOUND"
        lines.append(
            f"{row['true_hz']:g} Hz: {state}, nearest {row['nearest_hz']:.3f} Hz, "
            f"largest {row['amplitude_px']:.3f} px, truth {row['true_px']:.3f} px"
        )
        for name in ("picture", "picture_apart", "space"):
            if name in row:
                lines.append(f"  {name:15}" + "  ".join(f"{k} {v:.4g}" for k, v in row[name].items()))
        if "yardstick" in row:
            lines.append(f"  (the two truths in the picture differ by {row['yardstick']:.3f})")
    wrong = [f"{p['frequency_hz']:.3f} Hz ({p['amplitude_px']:.3f} px)" for p in figures["false_peaks"]]
    lines.append(f"false peaks: {', '.join(wrong) or 'none'}")
    for row in figures.get("clip_phases", []):
        errors = "  ".join(f"{name} {error:+.1f}" for name, error in row["errors_deg"].items())
        lines.append(f"clips' phases at {row['frequency_hz']:g} Hz, errors in degrees: {errors}")
    for view, values in figures.get("pictures", {}).items():
        lines.append(f"SSIM ×{ALPHA} {view}: " + "  ".join(f"{k} {v:.4f}" for k, v in values.items()))
    return "\n".join(lines)
