"""Training from a dataset to a run: settings, stages in order, nothing done twice, kills that are real."""

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.run.preset import presets
from tg4mm.run.train import parse_settings, train

SETTINGS = {
    "space.iterations": "20", "space.max_gaussians": "300", "motion.components": "2", "motion.iterations": "3",
}  # fmt: skip


def one_line(match):
    return pytest.raises(Tg4mmError, match=rf"\A[^\n]*{match}[^\n]*\Z")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("train") / "data"
    make_synthetic_dataset(path, n_views=3, n_timesteps=6, size=32, freqs=(6.0,), alphas=(), n_test=0)
    return path


@pytest.fixture(scope="module")
def trained(data):
    return train(data, data.parent / "run", settings=SETTINGS)


class TestSettings:
    @pytest.mark.parametrize(
        ("name", "meant"),
        [
            ("space.iteration", "did you mean space.iterations[?]"),
            ("iterations", "did you mean space.iterations or motion.iterations[?]"),
            ("colour.iterations", "did you mean space.iterations or motion.iterations[?]"),
            ("apearance", "did you mean motion.appearance[?]"),
            ("space", "tg4mm train"),
            ("space.", "tg4mm train"),
            ("", "tg4mm train"),
        ],
    )
    def test_an_unknown_one_is_refused_with_those_that_may_be_meant(self, name, meant):
        with one_line(rf"setting {name!r} is unknown; {meant}.* --list-settings lists all") as refused:
            parse_settings({name: "3"})
        assert meant.startswith("did") == ("did you mean" in str(refused.value))

    def test_all_are_listed_with_default_unit_and_meaning(self, capsys):
        assert main(["train", "--list-settings"]) == 0
        lines = capsys.readouterr().out.splitlines()
        for preset, defaults in ((p, c.defaults) for p, c in presets().items()):
            start = lines.index(f"--preset {preset}") + 1
            names = [f"{stage}.{key}" for stage, config in defaults.items() for key in vars(config)]
            rows = lines[start : start + len(names)]
            assert [row.split()[0] for row in rows] == names
            assert all(re.fullmatch(r"  [a-z_.0-9]+ +\S+( \S+)*  +\S.*", row) for row in rows), rows
        assert any("space.max_gaussians" in line and "0 Gaussians" in line for line in lines)

    @pytest.mark.parametrize(
        ("name", "text", "kind"),
        [
            ("space.iterations", "many", "int"),
            ("space.iterations", "2.5", "int"),
            ("space.iterations", "", "int"),
            ("motion.ridge", "1,5", "float"),
        ],
    )
    def test_a_value_of_the_wrong_type_is_refused(self, name, text, kind):
        with one_line(f"setting {name} is {re.escape(repr(text))}, expected {kind}"):
            parse_settings({name: text})


class TestRequests:
    @pytest.mark.parametrize(
        "wrong", ["space.seed=-1", "motion.tolerance=5", "motion.seed=-1", "space.init=cloud"]
    )
    def test_settings_out_of_range_leave_no_run_behind(self, wrong, data, tmp_path):
        """Else the folder would be bound to the bad value, and the right one refused. And no minutes are lost."""
        name, value = wrong.split("=")
        with one_line(f"setting {name} is {value}"):
            train(data, tmp_path / "run", settings=SETTINGS | {name: value})
        assert not (tmp_path / "run").exists()

    @pytest.mark.parametrize(("n_timesteps", "is_refused"), [(2, True), (5, True), (6, False)])
    def test_a_record_in_which_no_frequency_can_be_resolved_is_refused(
        self, n_timesteps, is_refused, tmp_path
    ):
        path = tmp_path / "data"
        make_synthetic_dataset(path, n_views=2, n_timesteps=n_timesteps, size=24, alphas=(), n_test=0)
        if is_refused:
            with one_line(f"{path}: a camera holds {n_timesteps} pictures over time, too few"):
                train(path, tmp_path / "run", settings=SETTINGS)
            assert not (tmp_path / "run").exists()
        else:
            assert train(path, tmp_path / "run", settings=SETTINGS).has_motion

    def test_settings_that_do_not_fit_the_data_leave_no_run_behind(self, data, tmp_path):
        bare = tmp_path / "bare"
        shutil.copytree(data, bare, ignore=shutil.ignore_patterns("points3d.ply"))
        with one_line("init is 'points'"):
            train(bare, tmp_path / "run", settings={"space.init": "points"})
        assert not (tmp_path / "run").exists()


class TestResult:
    def test_training_ends_with_the_result_and_does_so_again(self, data, trained, capsys):
        command = ["train", str(data), "--out", str(trained.path)]
        for name, value in SETTINGS.items():
            command += ["--set", f"{name}={value}"]
        shown = []
        for _ in range(2):
            assert main(command) == 0
            shown.append(capsys.readouterr().out)
        lines = shown[0].splitlines()
        assert shown[0] == shown[1]
        assert lines[0].startswith(f"{trained.path}: 3 fixed cameras, 6 timesteps at 30 Hz")
        assert lines[-1].split()[:4] == ["next", "tg4mm", "render", str(trained.path)]
        assert 3 < len(lines) < 16


class TestStages:
    def test_both_stages_are_done_and_logged(self, trained):
        assert trained.has_space
        assert trained.has_motion
        assert trained.settings["space"]["iterations"] == 20
        for stage in ("space", "motion"):
            assert trained.log()[stage]["seconds"] > 0
            assert trained.log()[stage]["peak_memory_mib"] > 0
        assert trained.log()["space"]["n_gaussians"] == len(trained.load_space())
        motion = trained.load_motion()
        assert motion.displacement.shape == (3, len(trained.load_space()), 3)
        assert not list(trained.path.glob("checkpoint_*"))

    def test_a_finished_run_is_not_touched(self, trained, data, monkeypatch):
        def never(*args, **kwargs):
            raise AssertionError("a finished stage was run again")

        for name in ("train_space", "train_motion", "pictures_for"):
            monkeypatch.setattr(f"tg4mm.run.preset.{name}", never)
        before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in trained.path.iterdir()}
        assert train(data, trained.path, settings=SETTINGS).path == trained.path
        assert {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in trained.path.iterdir()} == before

    def test_one_timestep_ends_after_the_space_stage(self, tmp_path):
        path = tmp_path / "data"
        make_synthetic_dataset(path, n_views=3, n_timesteps=1, size=24, alphas=(), n_test=0)
        for source, name in ((path, "tree"), (path / "000", "folder")):
            run = train(source, tmp_path / name, settings=SETTINGS)
            assert run.has_space
            assert not run.has_motion
            assert set(run.log()) == {"space"}
            assert train(source, tmp_path / name, settings=SETTINGS).has_space


def same_results(one, other):
    for name in ("means", "quats", "scales", "opacities", "sh"):
        a, b = getattr(one.load_space(), name), getattr(other.load_space(), name)
        np.testing.assert_array_equal(a.numpy(), b.numpy())
    a, b = one.load_motion(), other.load_motion()
    assert a is not None
    assert b is not None
    for name in ("freqs_hz", "displacement", "rotation"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.slow
def test_pictures_that_stay_on_disk_give_the_same_bits(data, trained, tmp_path, monkeypatch):
    """As those of long captures do, which memory would not hold."""
    monkeypatch.setattr("tg4mm.capture.pictures.IN_MEMORY", 0)
    whole = "tg4mm.capture.pictures.load_images"
    monkeypatch.setattr(whole, lambda _: pytest.fail("all pictures were loaded"))
    same_results(trained, train(data, tmp_path / "run", settings=SETTINGS))


def test_cameras_at_one_place_are_refused(data, tmp_path):
    """They turn about their common centre: nothing tells how far things are."""
    turned = shutil.copytree(data, tmp_path / "turned")
    for path in turned.glob("*/transforms_train.json"):
        content = json.loads(path.read_text())
        for frame in content["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] = 0.25
        path.write_text(json.dumps(content))
    with one_line("all 3 cameras stand at one place"):
        train(turned, tmp_path / "run", settings=SETTINGS)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("size", [(1, 1), (64, 1), (1, 64)])
def test_pictures_of_a_row_a_column_or_a_pixel_are_refused(data, tmp_path, size):
    thin = shutil.copytree(data, tmp_path / "thin")
    for path in thin.glob("*/train/*.png"):
        Image.open(path).resize(size).save(path)
    with one_line(f"pictures are {size[0]}×{size[1]} pixels, expected 8 or more"):
        train(thin, tmp_path / "run", settings=SETTINGS)
    assert not (tmp_path / "run").exists()
