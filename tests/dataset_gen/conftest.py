"""Fixtures: the built-in scene that a module is about, by its `SCENE = "chair"`; a set with a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dataset_gen.scene import Part, Scene
from tests.dataset_gen import builtin


@pytest.fixture(scope="module")
def scene(request: pytest.FixtureRequest) -> Scene:
    return builtin.built(request.module.SCENE)


@pytest.fixture(scope="module")
def parts(scene: Scene) -> dict[str, Part]:
    return {part.name: part for part in scene.parts}


@pytest.fixture(scope="module")
def moves(request: pytest.FixtureRequest) -> dict[str, np.ndarray]:
    """Mode shapes [K, V, 3] by part."""
    return builtin.solved(request.module.SCENE)


@pytest.fixture(scope="module")
def shapes(moves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The first mode's shape [V, 3] by part."""
    return {name: shape[0] for name, shape in moves.items()}


@pytest.fixture(scope="session")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole set of tests/dataset_gen/planes.py, with second renders."""
    from tests.dataset_gen.planes import Plane  # needs the packages of the report

    made = Plane(tmp_path_factory.mktemp("set") / "plane_3Hz_0_02")
    made.write(unit_scale_m=0.1, modes=[{"name": "sway", "kind": "rigid"}, {"name": "heave"}])
    made.truth()
    made.reseed()
    return made.root


@pytest.fixture(scope="session")
def page(plane: Path) -> str:
    """The report of `plane`."""
    from dataset_gen.report import write_report

    return write_report(plane).read_text(encoding="utf-8")
