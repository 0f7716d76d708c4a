"""A `paper` run magnified, rendered, evaluated and exported: each method, through the commands that users have."""

import json

import numpy as np
import pytest
import torch

from tests.research.paper.conftest import N_TIMESTEPS
from tg4mm.cli import main
from tg4mm.core.magnification import BandGain, Magnification, TemporalFilter
from tg4mm.core.splatfile import read_splat
from tg4mm.research.paper.model import load_model, load_planes, plane_video
from tg4mm.research.paper.preset import FOLDER, series_of
from tg4mm.run.preset import poses_of
from tg4mm.show.export.lowpass import smoothing_of

IDEAL = TemporalFilter("ideal")


def plan(alpha, method, filter=IDEAL):
    return Magnification((BandGain(4, 6, alpha),), method=method, filter=filter)


@pytest.fixture(scope="module")
def embeddings(trained):
    """(model, [T, N, 3 C] as trained)."""
    model = load_model(trained)
    own = [model.embedding(load_planes(trained, t, model)) for t in range(1, N_TIMESTEPS)]
    return model, torch.stack([model.rest_embedding, *own]).numpy()


@pytest.mark.parametrize("method", ["linear", "phase"])
def test_no_magnification_is_the_run_itself(trained, embeddings, method):
    model, expected = embeddings
    series = series_of(trained, method, plan(0.0, method))
    np.testing.assert_allclose(series.embeddings.transpose(1, 2, 0), expected, atol=1e-5)
    now = series.at(2.0)
    own = model.decode(torch.from_numpy(expected[2]))
    torch.testing.assert_close(now.means, own.means, atol=1e-5, rtol=0)


def test_linear_adds_alpha_times_the_band_of_each_embedding(trained, embeddings):
    _, e = embeddings
    series = series_of(trained, "linear", plan(10.0, "linear"))
    spectrum = np.fft.rfft(e.astype(float), axis=0)
    spectrum[[0, 2, 3]] = 0  # T = 6 at 30 Hz: bin 1 is 5 Hz
    expected = e + 10 * np.fft.irfft(spectrum, N_TIMESTEPS, axis=0)
    np.testing.assert_allclose(series.embeddings.transpose(1, 2, 0), expected, atol=1e-4)


@pytest.mark.parametrize("method", ["modal", "linear", "phase"])
def test_motion_grows_with_alpha(trained, method):
    temporal = None if method == "modal" else IDEAL
    rest = trained.load_space().means

    def size(alpha):
        poses = poses_of(trained, plan(alpha, method, temporal))
        return sum(float((poses.at(t).means - rest).norm()) for t in range(N_TIMESTEPS))

    still, once, more = size(-1.0), size(0.0), size(4.0)
    assert still < once < more
    if method == "phase":
        # What motion planes add is no shift of what the space planes show: phases grow, motion less.
        assert more < 6 * once
    else:
        assert 3 < more / once < 6  # 1 + alpha = 5


def test_a_second_request_finds_what_the_first_made_and_a_killed_one_goes_on(trained, monkeypatch):
    import tg4mm.research.paper.preset as module

    wanted = plan(3.0, "phase")
    calls: list[int] = []

    def counted(*arguments):
        calls.append(arguments[-1])
        if len(calls) == 5 and not done:
            raise KeyboardInterrupt
        return plane_video(*arguments)

    done = False
    monkeypatch.setattr(module, "plane_video", counted)
    with pytest.raises(KeyboardInterrupt):
        series_of(trained, "phase", wanted)
    done, n_planes = True, 12
    first = series_of(trained, "phase", wanted).embeddings.copy()
    assert len(calls) == n_planes + 1
    again = series_of(trained, "phase", wanted).embeddings
    assert len(calls) == n_planes + 1
    np.testing.assert_array_equal(first, again)
    assert not list((trained.path / FOLDER).glob("*.part"))
    assert len(list((trained.path / FOLDER).glob("*.f32"))) <= 4


class TestCommands:
    def test_render(self, trained, tmp_path):
        bands = ["--alpha", "5", "--alpha", "-1", "--band", "4", "6", "--band", "9", "11"]
        options = [*bands, "--filter", "ideal", "--allow-empty-band"]  # the record holds one period
        for method, name in ((["--method", "phase"], "phase"), ([], "own")):
            out = tmp_path / name
            words = [*options, *method, "--no-video", "--out", str(out)]
            assert main(["render", str(trained.path), *words]) == 0
            assert len(list(out.rglob("*.png"))) == 2 * N_TIMESTEPS
        record = json.loads((tmp_path / "phase" / "render.json").read_text())
        assert record["bands"] == [[4, 6, 5], [9, 11, -1]]
        assert (record["method"], record["filter"]) == ("phase", ["ideal", 0])
        assert json.loads((tmp_path / "own" / "render.json").read_text())["method"] is None
        out, masked = tmp_path / "masked", ["--suppressed", "--amplitude-percentile", "50"]
        options += ["--method", "phase", *masked, "--no-video", "--out", str(out)]
        assert main(["render", str(trained.path), *options]) == 0
        record = json.loads((out / "render.json").read_text())
        assert (record["suppressed"], record["amplitude_percentile"]) == (True, 50)
        pictures = [sorted((tmp_path / name).rglob("*.png")) for name in ("phase", "masked")]
        assert [p.read_bytes() for p in pictures[0]] != [p.read_bytes() for p in pictures[1]]

    def test_evaluate(self, trained, tmp_path, capsys):
        out = tmp_path / "m.json"
        options = ["--alphas", "5", "--band", "4", "6", "--allow-empty-band", "--out", str(out)]
        assert main(["evaluate", str(trained.path), *options, "--method", "phase", "--filter", "ideal"]) == 0
        phase = json.loads(out.read_text())
        assert (phase["method"], phase["filter"], phase["band_hz"]) == ("phase", "ideal", [4, 6])
        assert main(["evaluate", str(trained.path), *options, "--method", "modal"]) == 0
        modal = json.loads(out.read_text())
        assert (modal["method"], modal["filter"]) == ("modal", None)
        rows = [m["alphas"][1]["rows"] for m in (phase, modal)]
        assert rows[0]["nothing moves"] == rows[1]["nothing moves"]
        assert rows[0]["ours"] != rows[1]["ours"]
        assert "nothing moves" in capsys.readouterr().out

    def test_export(self, trained, tmp_path):
        assert main(["export", str(trained.path), "--out", str(tmp_path / "a.ply")]) == 0
        splat = read_splat(tmp_path / "a.ply")
        np.testing.assert_allclose(splat.freqs_hz, [0, 5, 10, 15])
        options = ["--format", "ply-sequence", "--alpha", "5", "--band", "4", "6", "--method", "phase"]
        options.append("--allow-empty-band")
        assert main(["export", str(trained.path), "--out", str(tmp_path / "s"), *options]) == 0
        poses = poses_of(trained, Magnification((BandGain(4, 6, 5.0),), method="phase"))
        frame = read_splat(tmp_path / "s" / "frame_0002.ply")
        np.testing.assert_allclose(frame.means, poses.at(2.0).means, atol=1e-6)
        low_pass = smoothing_of(trained)[:, None]
        np.testing.assert_allclose(frame.scales**2, poses.at(2.0).scales ** 2 + low_pass, rtol=1e-4)
        assert main(["export", str(trained.path), "--out", str(tmp_path / "b.ply"), "--method", "phase"]) == 2
