"""What is known exactly of the fox's room: its motion at any point, its cameras, and how a run's world lies in it."""

import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from tg4mm.capture import Capture
from tg4mm.core.errors import CaptureError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.show.render.cameras import Camera

SEEN = 0.1  # opacity from which a truth Gaussian counts as a point of a surface
NEIGHBOURS = 4
PHASE_RAD = (0.0, 1.0)  # of the two sines at t = 0


@dataclass(frozen=True)
class Similarity:
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


def similarity(run_c2w: np.ndarray, truth_c2w: np.ndarray) -> Similarity:
    """The similarity that takes cameras [C, 4, 4] of a run to their true poses (camera-to-world, OpenCV axes).

    The rotation is the chordal mean of what the orientations say, scale and shift fit the centres to it by least
    squares (Umeyama 1991, with the rotation known): a short path of the camera does not tilt the world.
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
    return Similarity(scale, rotation, target.mean(0) - scale * rotation @ source.mean(0))


@dataclass(frozen=True)
class Truth:
    """truth.json and gauss.npz: x(t) = means + Σ_f shapes[f] sin(2π f t + phase of f + phase of the clip)."""

    folder: Path
    values: dict[str, Any]
    means: np.ndarray  # [M, 3]
    opacities: np.ndarray  # [M]
    shapes: np.ndarray  # [F, M, 3] displacement amplitudes, scene units

    @classmethod
    def load(cls, folder: Path) -> "Truth":
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
        shapes = self.shapes[:, self.opacities > SEEN]
        at = np.einsum("nk,fnkc->fnc", weight, shapes[:, index])
        return at * np.array([self.turn(f) for f in range(len(at))])[:, None, None]

    @staticmethod
    def turn(f: int) -> complex:
        """What makes shapes[f] the phasor m of Re[m exp(i 2π f t)]: sin(x + φ) = Re[−i exp(iφ) exp(ix)]."""
        return complex(-1j * np.exp(1j * PHASE_RAD[f]))

    def splats(self) -> Gaussians:
        """The truth's means as round Gaussians without colour, half as wide as three neighbours are far."""
        distance, _ = cKDTree(self.means).query(self.means, NEIGHBOURS)
        widths = torch.from_numpy(distance[:, 1:].mean(1) / 2).float()
        n = len(self.means)
        quats = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(n, 1)
        scales = widths[:, None].expand(n, 3).contiguous()
        opacities = torch.from_numpy(self.opacities).float()
        return Gaussians(torch.from_numpy(self.means).float(), quats, scales, opacities, torch.zeros(n, 1, 3))

    def c2w(self, name: str, timestep: int, kind: str) -> np.ndarray | None:
        """True camera-to-world [4, 4] of a picture called `name` (without suffix); None if it is none of the set's.

        Photographs are called by their number in the sweep, fixed cameras and clips cam_00 …; all of a handheld
        video is one moving camera.
        """
        if kind == "handheld":
            poses = self.values["hand"]
            return np.array(poses[timestep]) if timestep < len(poses) else None
        if match := re.fullmatch(r"cam_([0-9]+)", name):
            c, cameras = int(match[1]), self.values["clips"]["cams"]
            if kind == "clips":
                return np.array(self.values["cams_sweep"][cameras[c]]) if c < len(cameras) else None
            return np.array(self.values["c2w_fixed"]) if c == 0 else None
        if match := re.fullmatch(r"(?:sweep_)?([0-9]+)", name):
            i = int(match[1])
            return np.array(self.values["cams_sweep"][i]) if i < len(self.values["cams_sweep"]) else None
        return None

    def camera(self, name: str, size: tuple[int, int], world: Similarity) -> Camera:
        """`c2w_fixed` or `c2w_novel` in a run's world, for pictures of this size (width, height)."""
        K = np.array(self.values["K"])
        K[0] *= size[0] / self.values["W"]
        K[1] *= size[1] / self.values["H"]
        return Camera(name, world.viewmat_of(np.array(self.values[name])), K, *size)


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


def kind_of(capture: Capture) -> str:
    """How the capture was taken, by its scene.json. Raises CaptureError where that does not say."""
    kind = capture.scene.get("kind")
    if kind not in ("tripod", "handheld", "clips", "flat"):
        raise CaptureError(
            f"{capture.root / 'scene.json'}: kind is {kind!r}, expected tripod, handheld, clips or flat"
        )
    return str(kind)


def world_of(capture: Capture, truth: Truth) -> tuple[Similarity, float]:
    """How the capture's world lies in the truth's, by its cameras, and the rms distance left between centres.

    Pictures are matched by name and, of a handheld video, by time. Raises CaptureError where too few are known.
    """
    kind = kind_of(capture)
    times = np.asarray(capture.times_s) * truth.values["fps"]
    frames = np.where(np.isfinite(times), np.rint(np.nan_to_num(times)), capture.timesteps).astype(int)
    _, first = np.unique(capture.camera_ids, return_index=True)
    pairs = []
    for i in first:
        known = truth.c2w(capture.paths[i].stem, int(frames[i]), kind)
        if known is not None:
            pairs.append((np.linalg.inv(capture.viewmats[i]), known))
    if len(pairs) < 3:
        raise CaptureError(f"{capture.root}: {len(pairs)} pictures have a true pose, expected at least 3")
    run_c2w, truth_c2w = (np.stack(poses) for poses in zip(*pairs, strict=True))
    world = similarity(run_c2w, truth_c2w)
    left = world.to_truth(run_c2w[:, :3, 3]) - truth_c2w[:, :3, 3]
    return world, float(np.sqrt((left**2).sum(1).mean()))


def project(xyz: np.ndarray, c2w: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates [N, 2] (centres at +0.5) and depths [N] of points [N, 3]; c2w has OpenCV axes."""
    in_camera = (xyz - c2w[:3, 3]) @ c2w[:3, :3]
    depth = in_camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (in_camera @ K.T)[:, :2] / depth[:, None], depth


def visible(uv: np.ndarray, depth: np.ndarray, size: tuple[int, int], cell: int = 6) -> np.ndarray:
    """[N] whether a point lies in the picture and within 3 % of the nearest depth among points in its cell.

    size: width, height; cell: side in pixels.
    """
    inside = (depth > 0.05) & (uv >= 0).all(1) & (uv < np.array(size)).all(1)
    columns = -(-size[0] // cell)
    index = np.zeros(len(uv), np.int64)
    index[inside] = (uv[inside, 1] // cell).astype(int) * columns + (uv[inside, 0] // cell).astype(int)
    nearest = np.full(columns * (-(-size[1] // cell)), np.inf)
    np.minimum.at(nearest, index[inside], depth[inside])
    return inside & (depth <= 1.03 * nearest[index])
