"""The stages as functions: the same as a run gives, without writing anything; and the page about them, executed."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

import tg4mm
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.fit.motion.animate import animate
from tg4mm.run.train import train

SPACE = tg4mm.SpaceConfig(iterations=300, max_gaussians=800)
MOTION = tg4mm.MotionConfig(appearance=False)
HZ = 3.0


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("api") / "data" / "mic_5Hz_0_005"
    make_synthetic_dataset(path, freqs=(HZ,), n_timesteps=20)
    return path


@pytest.fixture(scope="module")
def capture(data):
    return tg4mm.load_capture(data)


@pytest.fixture(scope="module")
def fit(capture):
    return tg4mm.fit_motion(capture, tg4mm.fit_space(capture, SPACE), MOTION)


@pytest.fixture(scope="module")
def run(data):
    settings = {"space.iterations": "300", "space.max_gaussians": "800", "motion.appearance": "false"}
    return train(data, data.parent.parent / "run", settings=settings)


def test_the_fit_is_a_runs(fit, run):
    stored = run.load_fit()
    for field in fields(fit.gaussians):
        assert torch.equal(getattr(fit.gaussians, field.name), getattr(stored.gaussians, field.name))
    for name in ("freqs_hz", "displacement", "rotation"):
        exact = getattr(fit.motion, name)
        bound = 1e-6 * np.abs(exact).max()
        np.testing.assert_allclose(getattr(stored.motion, name), exact, rtol=0, atol=bound)
    assert fit.uncertainty.keys() == stored.uncertainty.keys()
    assert (fit.notes, fit.config) == (stored.notes, stored.config)
    assert fit.config == MOTION


def test_a_measurement_is_a_runs(capture, run):
    sensors = [tg4mm.Sensor("top", "box", (-0.6, -0.3, 1.0, 0.0, 0.3, 1.5)), tg4mm.Sensor("all", "all")]
    stored = run.load_fit()  # the same but for rounding: the test above
    here = tg4mm.measure(tg4mm.prepare_fit(capture, stored), sensors)
    there = tg4mm.measure(run, sensors)
    for name in ("top", "all"):
        np.testing.assert_allclose(here[name].displacement, there[name].displacement, atol=1e-9)
        np.testing.assert_allclose(here[name].deviation, there[name].deviation, atol=1e-9)
    assert here["top"].spectrum.peaks[0].frequency_hz == pytest.approx(HZ, abs=0.02)
    assert here.prepared.folder is None


def test_nothing_is_written(data, capture, fit, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in data.rglob("*")}
    tg4mm.fit_motion(capture, tg4mm.fit_space(capture, replace(SPACE, iterations=20)), MOTION)
    tg4mm.measure(tg4mm.prepare_fit(capture, fit), [tg4mm.Sensor("all", "all")])
    assert {path: path.stat().st_mtime_ns for path in data.rglob("*")} == before
    assert not list(tmp_path.iterdir())


def test_magnifying(fit):
    def means(magnification=0.0):
        return tg4mm.animate(fit, 3, magnification).means.numpy()

    rest = tg4mm.animate(fit, 3, -1).means.numpy()
    np.testing.assert_array_equal(means(), animate(fit.gaussians, fit.motion, 3).means.numpy())
    np.testing.assert_allclose(means(7) - rest, 8 * (means() - rest), atol=1e-5)
    inside, outside = (tg4mm.Magnification((tg4mm.BandGain(*band, 7),)) for band in ((2, 4), (9, 11)))
    at_3_hz = np.abs(fit.motion.freqs_hz - HZ) < 0.5
    assert at_3_hz.any()
    in_band = (fit.motion.freqs_hz >= 2) & (fit.motion.freqs_hz <= 4)
    only = animate(fit.gaussians, fit.motion, 3, 7 * in_band)
    np.testing.assert_array_equal(means(inside), only.means.numpy())
    assert np.abs(means(outside) - means()).max() < 0.2 * np.abs(means(inside) - means()).max()


def test_a_picture_shows_what_the_camera_saw(capture, fit):
    camera, images = tg4mm.capture_cameras(capture)[0], tg4mm.load_images(capture)
    row = int(np.flatnonzero((capture.camera_ids == 0) & (capture.timesteps == 4))[0])
    picture = tg4mm.render(tg4mm.animate(fit, 4), camera)
    assert picture.shape == (48, 48, 3)
    assert picture.dtype == np.float32
    error = np.sqrt(((picture - images.rgb(row)) ** 2).mean())
    other = np.sqrt(((picture[::-1] - images.rgb(row)) ** 2).mean())
    assert error < 0.05 < other


def test_one_fixed_camera_is_a_plane(capture):
    rows = np.flatnonzero(capture.camera_ids == 0)
    flat = replace(capture.selected(rows), kind="flat")
    gaussians = tg4mm.fit_space(flat, tg4mm.SpaceConfig(max_gaussians=200))
    depth = gaussians.means.numpy() @ capture.viewmats[rows[0]][2, :3] + capture.viewmats[rows[0]][2, 3]
    np.testing.assert_allclose(depth, 1, atol=0.01)
    assert "flat capture" in " ".join(tg4mm.fit_motion(flat, gaussians, MOTION).notes)


def test_bad_input(capture, fit):
    with pytest.raises(tg4mm.Tg4mmError, match=r"space\.sh_degree is 9, expected 0 to 3"):
        tg4mm.fit_space(capture, tg4mm.SpaceConfig(sh_degree=9))
    with pytest.raises(tg4mm.Tg4mmError, match="tpu"):
        tg4mm.fit_space(capture, device="tpu")
    with pytest.raises(tg4mm.CaptureError, match="reaches past half the frame rate"):
        tg4mm.animate(fit, 0, tg4mm.Magnification((tg4mm.BandGain(4.0, 40.0, 5),)))
    for t, alpha, said in (
        (0, float("nan"), "magnification is nan, expected a finite number"),
        (0, "20", "magnification is '20', expected a finite number"),
        (float("inf"), 20, "t is inf, expected a finite number"),
        (0, 1e12, "alpha is 1000000000000.0, expected"),
        (0, tg4mm.Magnification.of("20"), "alpha is '20', expected"),
        (0, tg4mm.Magnification.of([5], (2, 4)), r"alpha is \[5\], expected"),
        (0, tg4mm.Magnification.of(5, (1e-6, 2e-6)), r"band \(1e-06, 2e-06\) Hz holds no frequency .*: \d"),
    ):
        with pytest.raises(tg4mm.Tg4mmError, match=said):
            tg4mm.animate(fit, t, alpha)
    with pytest.raises(tg4mm.RunError, match="method 'phase'"):
        tg4mm.animate(fit, 0, tg4mm.Magnification(method="phase"))
    with pytest.raises(tg4mm.CaptureError, match=r"band \(2,\) is not two frequencies"):
        tg4mm.Magnification.of(5, (2,))
    known = replace(fit.motion, gains=np.stack([fit.motion.gains_at(t) for t in range(3)], 1))
    with pytest.raises(
        tg4mm.RunError, match=r"timestep 3: this motion is only defined at whole timesteps 0 … 2"
    ):
        tg4mm.animate(replace(fit, motion=known), 3)
    still = replace(capture, n_timesteps=1)
    with pytest.raises(tg4mm.Tg4mmError, match="has one timestep"):
        tg4mm.prepare_fit(still, fit)


@pytest.mark.slow
def test_the_packages_own_example(data, monkeypatch, capsys):
    """The lines of `help(tg4mm)`."""
    monkeypatch.chdir(data.parent.parent)
    lines = [line.strip() for line in (tg4mm.__doc__ or "").splitlines() if line.startswith("    ")]
    assert 8 <= len(lines) <= 10
    names: dict[str, object] = {"tg4mm": tg4mm}
    exec("\n".join(lines), names)
    assert names["picture"].shape == (48, 48, 3)
    assert names["waveform"].displacement.shape == (20, 3)
