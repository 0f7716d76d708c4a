"""What the harness knows of a reader: its sample, how it reads, what may happen to the file; and samples of runs."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from tests.faults.mutate import Mutation
from tg4mm.core.untrusted import write_sealed
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion
from tg4mm.research.paper.model import PaperConfig, save_model, save_planes
from tg4mm.research.paper.space import started
from tg4mm.run import Run

N, T = 5, 3  # Gaussians, timesteps


@dataclass(frozen=True)
class Reader:
    """`make(folder)` writes the sample and gives the file that is mutated, `read(folder)` reads all of it."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    mutate: Mutation


def reading(pattern, read):
    """Reads the one file whose name matches."""
    return lambda root: read(next(root.glob(pattern)))


def sample(path, content):
    """Writes one file: text, bytes, or what a function of its path writes."""

    def make(root):
        file = root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        if callable(content):
            content(file)
        else:
            file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return file

    return make


def record(path, values):
    """Writes a JSON file that is nothing but these values."""
    return sample(path, json.dumps(values))


def sealed(path, values):
    """Writes a JSON file with a digest."""
    return sample(path, lambda file: write_sealed(file, values))


def gaussians():
    rng = np.random.default_rng(0)
    shapes = {"means": (N, 3), "quats": (N, 4), "scales": (N, 3), "opacities": (N,), "sh": (N, 4, 3)}
    return Gaussians(
        **{k: torch.from_numpy(rng.uniform(0.1, 0.9, s).astype(np.float32)) for k, s in shapes.items()}
    )


def motion():
    rng = np.random.default_rng(1)
    displacement, rotation = rng.normal(size=(2, 2, N, 3)).astype(np.complex64)
    light = AppearanceModes(rng.normal(size=(1, N, 1, 3)).astype(np.float32), rng.normal(size=(2, 1)) + 0j)
    return ModalMotion.of_phasors(np.array([0.0, 5.0]), displacement, rotation, 30.0, T, appearance=light)


def run_of(name):
    """A whole run, with checkpoints as if its stages had been stopped."""

    def make(root):
        (root / "data").mkdir()
        run = Run.create(root / "run", root / "data", "modal", {"space": {"seed": 0, "l2": 0.5}})
        run.save_space(gaussians(), {"seconds": 1.5, "n_gaussians": N, "init": "points"})
        run.save_motion(motion(), {"seconds": 2.5, "peak_memory_mib": 100.0, "notes": ["a"]})
        run.save_part("uncertainty", {"displacement": torch.ones(N)})
        run.save_checkpoint(
            "space", {"means": torch.ones(N, 3), "x": torch.zeros(())}, {"iteration": 3, "order": [1]}
        )
        return root / "run" / name

    return make


def paper_run(name):
    def make(root):
        run_of("config.json")(root)
        model = started(gaussians(), PaperConfig(channels=2, resolution=16))
        run = Run.open(root / "run")
        save_model(run, model)
        save_planes(run, 1, torch.zeros(len(model.cells), 2))
        return root / "run" / name

    return make
