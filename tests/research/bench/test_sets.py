"""What the benchmark knows of a dataset: motion in pixels and its band from the truth; thinned and refused ones."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tg4mm.capture import load_capture
from tg4mm.capture.truth_file import load_truth
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.sets import check_alphas, open_set, open_sets


def one_line(match):
    return pytest.raises(BenchError, match=rf"\A[^\n]*{match}[^\n]*\Z")


def test_pixels_are_those_of_the_projected_vertices(data):
    found, capture = open_set(data, "x"), load_capture(data)
    truth = load_truth(data, capture.fps, capture.n_timesteps)
    viewmat, k = capture.viewmats[0], capture.Ks[0]

    def pixels(points):
        seen = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ k.T
        return seen[:, :2] / seen[:, 2:]

    largest = max(
        np.linalg.norm(pixels(b.rest + (1e-3 * m * np.exp(1j * phase)).real) - pixels(b.rest), axis=1).max()
        for b in truth.objects
        for m in b.modes
        for phase in np.linspace(0, np.pi, 721)
    )
    assert found.amplitude_px == pytest.approx(1e3 * largest, rel=1e-3)
    assert (found.frequency_hz, found.band_hz, found.alphas) == (5.0, (3.5, 6.5), (5, 20))
    assert (found.width, found.n_views, found.n_timesteps, found.group) == (32, 5, 6, "32×32, rig, 0.2 px")


def test_a_name_is_the_folders_own_or_the_one_given_whatever_else_is_opened(data, tmp_path):
    other = tmp_path / "px002" / data.name
    shutil.copytree(data, other)
    given = Path(f"px002={other}")
    assert [s.label for s in open_sets([data, given])] == [data.name, "px002"]
    assert [s.label for s in open_sets([given])] == ["px002"]
    with one_line(f"are both called {data.name}: give one as NAME=DIR"):
        open_sets([data, other])
    with one_line("the name may hold"):
        open_sets([Path(f"a b={other}")])
    with one_line("is named twice"):
        open_sets([data, Path(f"again={data}")])


def test_what_cannot_be_benchmarked_is_refused(data, tmp_path):
    with one_line("is named twice"):
        open_sets([data, data / ".." / data.name])
    with one_line("no dataset is named"):
        open_sets([])
    bare = tmp_path / "bare"
    shutil.copytree(data, bare, ignore=shutil.ignore_patterns("truth"))
    with one_line(r"bare has no truth/motion.npz"):
        open_sets([bare])
    shutil.copytree(data, tmp_path / "plain", ignore=shutil.ignore_patterns("magnified"))
    with one_line(r"plain has no magnified/x… folder"):
        open_sets([tmp_path / "plain"])
    with one_line(r"--alphas 7: dataset .* has ground truth for 5, 20"):
        check_alphas(open_sets([data]), (7.0,))
    check_alphas(open_sets([data]), (7.0, 20.0))
