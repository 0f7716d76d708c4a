"""The notebooks of examples/, executed at a tiny size: cells in order, the one tagged "parameters" replaced."""

import json
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset

pytest.importorskip("matplotlib", reason="needs the extra core")
HZ = 3.0


def execute(notebook, parameters, folder, monkeypatch):
    """Run its code in `folder`; the names that it leaves. Its figures are left open."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells = [c for c in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if c["cell_type"] == "code"]
    asked = [c for c in cells if "parameters" in c["metadata"].get("tags", ())]
    assert len(asked) == 1
    names: dict[str, Any] = {}
    for cell in cells:
        code = compile("".join(cell["source"]), f"{notebook.name}[{cell['id']}]", "exec")
        exec(code, names)
        if cell is asked[0]:
            assert parameters.keys() <= names.keys()  # a renamed parameter must not go unnoticed
            names |= parameters
    return names


@pytest.fixture
def figures():
    """Closes every figure at the end."""
    import matplotlib.pyplot as plt

    yield plt.get_fignums
    plt.close("all")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("notebooks") / "tiny"
    make_synthetic_dataset(path, freqs=(HZ,), n_timesteps=20, alphas=(20,))
    return path


@pytest.mark.slow
def test_first_run(repo_root, data, tmp_path, monkeypatch, figures):
    small = {"dataset": str(data), "space_iterations": 300}
    names = execute(repo_root / "examples" / "first_run.ipynb", small, tmp_path, monkeypatch)
    assert names["sensor"].spectrum.peaks[0].frequency_hz == pytest.approx(HZ, abs=0.05)
    assert (tmp_path / "first_run.ply").is_file()
    assert len(figures()) > 0


@pytest.mark.slow
def test_own_video(repo_root, tmp_path, monkeypatch, figures):
    pytest.importorskip("av", reason="needs the extra sfm")
    from tests.capture.sfm.videos import write_video

    n, fps, pixels = 40, 20, 0.3
    x, y = np.meshgrid(2 * np.pi * np.arange(96) / 96, 2 * np.pi * np.arange(72) / 72)
    rng = np.random.default_rng(0)
    waves = [(*rng.integers(-12, 13, 2), *rng.uniform(0, 2 * np.pi, 3)) for _ in range(30)]
    # Of the picture; all of it would be a camera that shakes.
    part = np.exp(-((x - 3) ** 2 + (y - 3) ** 2) / 2)
    frames = []
    for k in range(n):
        shift = pixels * np.sin(2 * np.pi * HZ * k / fps) * 2 * np.pi / 96 * part
        colours = [
            sum(np.cos(u * (x - shift) + v * y + phases[c]) for u, v, *phases in waves) for c in range(3)
        ]
        noisy = 128 + 12 * np.stack(colours, 2) + rng.normal(0, 2, (72, 96, 3))
        frames.append(np.clip(noisy, 0, 255).astype(np.uint8))
    # Without loss: at crf 8 the codec takes 7 % of this motion, which is tests/show/measure/test_compression.py's.
    video = write_video(tmp_path / "video.mp4", frames, Fraction(fps), crf=0)
    small = {"video": str(video), "dataset": str(tmp_path / "set"), "space": {"max_gaussians": 600}}
    names = execute(repo_root / "examples" / "own_video.ipynb", small, tmp_path, monkeypatch)
    spot = names["spot"]
    peak = spot.spectrum.peaks[0]
    assert peak.frequency_hz == pytest.approx(HZ, abs=0.05)
    u, v, radius = names["sensor"].values
    inside = np.hypot(x * 96 / (2 * np.pi) - u, y * 72 / (2 * np.pi) - v) < radius
    found, deviation = (a[0] * spot.px_per_unit for a in (peak.amplitude, peak.deviation))
    assert found == pytest.approx(pixels * part[inside].mean(), rel=0.15)
    assert abs(found - pixels * part[inside].mean()) < 2 * deviation
    assert peak.amplitude[1] < 0.2 * peak.amplitude[0]
    assert names["band"][0] < HZ < names["band"][1]
    assert (tmp_path / "own_video_magnified.mp4").stat().st_size > 0


@pytest.mark.slow
def test_compare_a_method(repo_root, data, tmp_path, monkeypatch, figures):
    small = {"dataset": str(data), "space_iterations": 300, "alpha": 20}
    names = execute(repo_root / "examples" / "compare_a_method.ipynb", small, tmp_path, monkeypatch)
    scores = names["scores"]
    assert scores["tg4mm"][1] > scores["nothing moves"][1]
