"""The preset `paper`: what is trained when, what stays, what is written, how it goes on after a kill."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from tests.helpers.runs import copied
from tests.research.paper.conftest import N_TIMESTEPS, SETTINGS
from tg4mm.capture import load_capture, load_images
from tg4mm.core.choices import Kind
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.fit.motion.animate import animate
from tg4mm.research.paper.model import load_model, load_planes, planes_name
from tg4mm.research.paper.motion import at_rest
from tg4mm.research.paper.space import cameras_on, first_views, view_loss
from tg4mm.run.train import train


def one_line(match):
    return pytest.raises(Tg4mmError, match=rf"\A[^\n]*{match}[^\n]*\Z")


def stored(path):
    """Every tensor of every file. Not the bytes: safetensors puts its header's entries in any order."""
    tensors = {}
    for file in sorted(path.glob("*.safetensors")):
        tensors |= {f"{file.name}: {name}": t for name, t in load_file(file).items()}
    return tensors


class TestSettings:
    @pytest.mark.parametrize(
        ("name", "value", "message"),
        [
            ("paper.resolution", "48", "setting paper.resolution is 48, expected a power of two"),
            ("paper.iterations", "60", r"paper.iterations is 60, expected more than paper.warm_up \(60\)"),
            ("paper.learning_rate", "0", "paper.learning_rate is 0.0, expected a finite number above 0"),
            (
                "space.iterations",
                "9",
                "space.iterations is 9; with the preset paper it must equal paper.warm_up",
            ),
        ],
    )
    def test_one_out_of_range_leaves_no_run(self, data, tmp_path, name, value, message):
        with one_line(message):
            train(data, tmp_path / "run", "paper", settings=SETTINGS | {name: value})
        assert not (tmp_path / "run").exists()


class TestTraining:
    def test_it_learns_the_scene_and_the_motion(self, trained):
        log = trained.log()
        assert log["space"]["iterations"] == 60
        assert log["triplane"]["iterations"] == 80
        assert log["motion"]["iterations"] == 60 * (N_TIMESTEPS - 1)
        model = load_model(trained)
        values = [load_planes(trained, t, model) for t in range(1, N_TIMESTEPS)]
        assert all(v.abs().max() > 1e-3 for v in values)
        for head in ("means", "quats", "log_scales", "logits", "sh"):
            assert model.decoder.parameters[f"{head}.weight"].any()
        # Timestep 3 has the pose of timestep 0 again: what moved until then is what phase 1 had missed. Seen from
        # there, displacements half a period apart are opposite.
        means = [model.decode(model.embedding(v)).means.flatten() for v in values]
        one, other = means[0] - means[2], means[3] - means[2]
        assert torch.nn.functional.cosine_similarity(one, other, dim=0) < -0.1

    def test_the_rest_scene_and_its_modes_are_what_is_decoded(self, trained):
        model, motion = load_model(trained), trained.load_motion()
        assert motion is not None
        rest = trained.load_space()
        torch.testing.assert_close(rest.means, model.rest().means)
        for t in range(N_TIMESTEPS):
            now = model.rest() if t == 0 else model.decode(model.embedding(load_planes(trained, t, model)))
            by_modes = animate(rest, motion, t)
            torch.testing.assert_close(by_modes.means, now.means.detach(), atol=1e-5, rtol=0)
            a, b = (torch.nn.functional.normalize(q, dim=1) for q in (by_modes.quats, now.quats.detach()))
            assert (a * b).sum(1).abs().min() > 1 - 1e-5


@pytest.mark.slow
class TestResume:
    @pytest.mark.parametrize(
        "after", ["space.safetensors", "triplane.safetensors", "planes_0002.safetensors"]
    )
    def test_a_killed_run_ends_bit_for_bit_the_same(self, trained, data, tmp_path, after):
        """kill -9 soon after a file has appeared, checkpoints at every iteration; then the same command again."""
        run = tmp_path / "run"
        code = (
            "import sys; from tg4mm.run.train import train; import tg4mm.research.paper.space as a, "
            "tg4mm.fit.space.train as b\n"
            "a.CHECKPOINT_EVERY_S = b.CHECKPOINT_EVERY_S = 0.0\n"
            f"train({str(data)!r}, {str(run)!r}, 'paper-tuned', settings={SETTINGS!r})"
        )
        job = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 120
        while not (run / after).exists() and job.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(0.1)
        os.kill(job.pid, signal.SIGKILL)
        assert job.wait() == -signal.SIGKILL, "the run ended before it was killed"
        train(data, run, "paper-tuned", settings=SETTINGS)
        again, once = stored(run), stored(trained.path)
        assert again.keys() == once.keys()
        assert [name for name in once if not torch.equal(again[name], once[name])] == []


class TestRefusals:
    @pytest.fixture
    def copy(self, trained, tmp_path):
        return copied(trained, tmp_path / "copy")

    def test_planes_of_another_timestep_or_run_are_refused(self, copy, trained):
        model = load_model(copy)
        shutil.copy(copy.part_file(planes_name(1)), copy.part_file(planes_name(2)))
        said = r"planes_0002\.safetensors belongs to a run with other settings, or"
        with pytest.raises(RunError, match=said):
            load_planes(copy, 2, model)
        with pytest.raises(RunError, match=r"has no planes_0009\.safetensors: its training is not finished"):
            load_planes(copy, 9, model)

    def test_shapes_that_do_not_fit_are_refused(self, copy):
        model = load_model(copy)
        copy.save_part(planes_name(1), {"values": torch.zeros(4, 3)})
        with pytest.raises(RunError, match=r"values have shape \(4, 3\) torch.float32, expected \(4, \d+\)"):
            load_planes(copy, 1, model)
        tensors, _ = copy.load_part("triplane")
        copy.save_part("triplane", tensors | {"sh": tensors["box"]}, residual=True)
        load_model(copy)  # more than needed does no harm
        copy.save_part("triplane", tensors | {"decoder.means.weight": torch.zeros(3, 5)}, residual=True)
        with pytest.raises(RunError, match="its tensors do not fit together"):
            load_model(copy)
        for name, wrong in (
            ("points", torch.zeros(())),
            ("points", torch.zeros(4, 2)),
            ("box", torch.zeros(6)),
        ):
            copy.save_part("triplane", tensors | {name: wrong.to(tensors[name].dtype)}, residual=True)
            said = r"points and box have shapes .*, expected \(N, 3\) and \(2, 3\)"
            with pytest.raises(RunError, match=said):
                load_model(copy)
        del tensors["base.sh"]
        copy.save_part("triplane", tensors, residual=True)
        with pytest.raises(RunError, match=r"has no tensor base\.sh"):
            load_model(copy)


@pytest.fixture(scope="module")
def views(data):
    capture = load_capture(data)
    return first_views(capture, load_images(capture))


def test_of_a_moving_camera_every_picture_tells_the_scene_at_rest(data):
    capture = load_capture(data)
    images = load_images(capture)
    found = [first_views(replace(capture, kind=Kind(kind)), images) for kind in ("handheld", "rig")]
    counts = [sorted(np.concatenate(views.images).tolist()) for views in found]
    assert counts == [list(range(len(capture))), np.flatnonzero(capture.timesteps == 0).tolist()]


def test_static_errors_cost_nothing(trained, views):
    model = load_model(trained)
    first = at_rest(model, views)
    # A picture with the model's error, an unmodelled gradient on top, and nothing that moved.
    gradient = np.linspace(0.5, 1.0, views.rgb.shape[2], dtype=np.float32)[:, None]
    wrong = replace(views, rgb=views.rgb * gradient)
    compared = replace(wrong, rgb=wrong.rgb + at_rest(model, wrong).missing)
    for v in range(len(views.rgb)):
        assert float(view_loss(model.rest(), cameras_on(wrong, "cpu"), v)) > 0.02
        assert float(view_loss(model.rest(), cameras_on(compared, "cpu"), v)) < 1e-6
    assert np.abs(first.missing).mean() > 1e-3  # the model is not perfect, so there is something to take out
