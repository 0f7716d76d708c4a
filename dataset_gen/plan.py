"""Which pictures have to be rendered, and which are the same picture again.

The principle that makes a dataset cheap: images depend on time and on α only through the motion state, that
is the displacement gain of each mode at t times (1 + α). The renderer is deterministic for a fixed seed, so
timesteps of equal state are equal byte for byte. Every distinct (state, view) is rendered once and its file
is hard-linked (copied where the file system has no links) to all the places that show it. A sine of 5 Hz at
30 frames per second has three states, 0 and ±sin 60°; the state 0 serves every α. 30 × 30 training images
then cost 90 renders.

Linked files share their bytes: replace a file, do not write into it.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from .cameras import Camera, test_cameras, train_cameras
from .settings import Settings
from .vibration import Motion, State


@dataclass(frozen=True)
class Shot:
    """One distinct picture: what to render, and where the files go, relative to the dataset's folder."""

    split: str
    camera: Camera
    state: State
    images: tuple[str, ...]  # PNG
    truth: tuple[str, ...]  # EXR; empty where no truth is wanted

    @property
    def sees_rest(self) -> bool:
        """True for the shots that colour points3d.ply."""
        return self.split == "train" and self.state.at_rest


def cameras_of(settings: Settings) -> dict[str, list[Camera]]:
    """Cameras per split."""
    test = test_cameras(settings.test_views) if settings.test_views else []
    return {"train": train_cameras(settings.views), "test": test}


def magnified_folder(alpha: float) -> str:
    """Folder of the ground truth at a magnification factor, "magnified/x005"."""
    return f"magnified/x{int(alpha):03d}"


def shots(settings: Settings, motion: Motion) -> list[Shot]:
    """All distinct pictures, sorted by state (moving geometry costs more than moving the camera)."""
    images: dict[tuple[State, str, int], list[str]] = defaultdict(list)
    truth: dict[tuple[State, str, int], list[str]] = defaultdict(list)
    cameras = cameras_of(settings)
    for split, views in cameras.items():
        for alpha in (0, *(settings.alphas if split == "test" else ())):
            root = f"{magnified_folder(alpha)}/" if alpha else ""
            for t in range(settings.timesteps):
                state = motion.state(t, alpha)
                for i, camera in enumerate(views):
                    images[state, split, i].append(f"{root}{t:03d}/{split}/{camera.name}.png")
                    if not alpha and settings.truth in (split, "all"):
                        truth[state, split, i].append(f"truth/{split}/{t:03d}/{camera.name}.exr")
    ordered = sorted(images, key=lambda key: (not key[0].at_rest, key[0].gains, key[1] != "train", key[2]))
    return [
        Shot(split, cameras[split][i], state, tuple(images[state, split, i]), tuple(truth[state, split, i]))
        for state, split, i in ordered
    ]
