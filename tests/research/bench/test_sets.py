"""What the benchmark knows of a dataset: motion in pixels and its band from the truth; thinned and refused ones."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dataset_gen.arguments import parser
from tg4mm.capture import load_capture, load_images
from tg4mm.capture.truth_file import load_truth
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.ablation.sets import generator_arguments, with_noise, with_views
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


class TestViews:
    def test_cameras_are_thinned_evenly_and_the_original_stays(self, data, tmp_path):
        whole, before = load_capture(data), (data / "scene.json").read_bytes()
        thin = load_capture(with_views(open_set(data, "x"), 3, tmp_path / "three"))
        assert [p.name for p in thin.paths[:3]] == ["r_000.png", "r_002.png", "r_004.png"]
        np.testing.assert_array_equal(thin.viewmats[:3], whole.viewmats[[0, 2, 4]])
        assert len(thin) == 3 * thin.n_timesteps
        assert len(load_capture(data)) == len(whole)
        assert (data / "scene.json").read_bytes() == before
        made = open_set(tmp_path / "three" / data.name, "x")
        same = pytest.approx(open_set(data, "x").amplitude_px)  # its first camera is the whole's
        assert (made.n_views, made.alphas, made.amplitude_px) == (3, (5, 20), same)
        test = load_capture(made.root, split="test", magnification=20)
        np.testing.assert_array_equal(
            test.viewmats, load_capture(data, split="test", magnification=20).viewmats
        )

    def test_an_unfinished_copy_is_made_again(self, data, tmp_path):
        left = tmp_path / "a" / f".{data.name}.tmp"
        left.mkdir(parents=True)
        (left / "half").write_text("")
        made = with_views(open_set(data, "x"), 2, tmp_path / "a")
        assert not left.exists()
        assert not (made / "half").exists()


class TestAmplitudes:
    def test_everything_but_the_amplitude_is_the_datasets_own(self, data, tmp_path):
        scene = {
            "scene": "mic", "fps": 24.0, "frequency_hz": 4.0, "n_test": 2, "seed": 7, "images": "png16",
            "background": "white", "engine": {"name": "CYCLES", "samples": 11}, "cameras": {"kind": "rig"},
            "sensor": None,
        }  # fmt: skip
        (tmp_path / "scene.json").write_text(json.dumps(scene))
        found = replace(open_set(data, "x"), root=tmp_path, fps=24.0)
        changed = {"--amplitude-px": "0.05", "--alphas": "20,40,80,160"}
        arguments = generator_arguments(found, changed, tmp_path / "out")
        options = dict(zip(arguments[1::2], arguments[2::2], strict=True))
        assert arguments[0] == "mic"
        assert options["--amplitude-px"] == "0.05"
        assert options["--alphas"] == changed["--alphas"]
        wanted = {
            "--size": "32",
            "--views": "5",
            "--timesteps": "6",
            "--samples": "11",
            "--seed": "7",
            "--fps": "24",
        }
        wanted |= {"--cameras": "rig", "--images": "png16", "--background": "white", "--test-views": "2"}
        assert wanted.items() <= options.items()
        parsed = parser().parse_args(arguments)
        assert (parsed.amplitude_px, parsed.size, parsed.samples) == (0.05, 32, 11)

    @pytest.mark.parametrize(
        "other",
        [
            {"effects": {"shake_px": 1.0}},
            {"engine": {"name": "BLENDER_EEVEE", "samples": 8}},
            {"cameras": {"kind": "rig", "clock_offset_s": 0.5}},
            {"sensor": {"iso": 100}},
        ],
    )
    def test_what_could_not_be_made_alike_is_refused(self, other, data, tmp_path):
        scene = {"scene": "mic", "frequency_hz": 4.0, "n_test": 2, "cameras": {"kind": "rig"}}
        scene |= {"engine": {"name": "CYCLES", "samples": 8}}
        found = replace(open_set(data, "x"), root=tmp_path)
        (tmp_path / "scene.json").write_text(json.dumps(scene))
        assert generator_arguments(found, {}, tmp_path / "out")[0] == "mic"
        (tmp_path / "scene.json").write_text(json.dumps(scene | other))
        with one_line("cannot be made with another amplitude"):
            generator_arguments(found, {}, tmp_path / "out")


def contents(root):
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_noise_of_the_size_asked_for_on_training_pictures_alone(data, tmp_path):
    before = contents(data)
    root = with_noise(open_set(data, "a"), 5.0, tmp_path)
    clean, noisy = (load_images(load_capture(r)).data.astype(np.float64) for r in (data, root))
    assert (clean[..., 3] == noisy[..., 3]).all()
    # where nothing is clipped
    inside = (clean[..., 3] > 0) & (clean[..., :3].min(-1) > 30) & (clean[..., :3].max(-1) < 225)
    difference = (noisy - clean)[..., :3]
    assert difference[inside].std() == pytest.approx(5.0, rel=0.05)
    assert abs(difference[inside].mean()) < 0.2
    assert (difference[clean[..., 3] == 0] == 0).all()
    assert len(np.unique(difference[:, 16, 16, 0])) > 5  # pictures have noise of their own
    test = "magnified/x020/003/test/r_000.png"
    assert (root / test).read_bytes() == (data / test).read_bytes()
    assert contents(data) == before
    assert contents(with_noise(open_set(data, "a"), 5.0, tmp_path / "again")) == contents(root)
