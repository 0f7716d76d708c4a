"""A run's result: the numbers are those of its motion, in every unit, and the lines say them."""

import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.capture.conftest import edit
from tests.helpers.look import found
from tests.helpers.runs import made_run
from tests.helpers.synthetic import exact_run, with_phasors
from tests.show.result.conftest import AMPLITUDE, DEVIATION, NOISE
from tg4mm.capture import load_capture
from tg4mm.capture.look.record import to_record
from tg4mm.cli import main
from tg4mm.run import UNCERTAINTY, Run
from tg4mm.show.result import lines_of, result_of
from tg4mm.show.result.model import with_deviation
from tg4mm.show.result.read import at_least_seen


@pytest.fixture(scope="module")
def result(run):
    return result_of(run)


@pytest.fixture
def copy(run, tmp_path):
    """A copy of the run and its dataset."""
    shutil.copytree(run.dataset, tmp_path / "data")
    shutil.copytree(run.path, tmp_path / "run")
    config = tmp_path / "run" / "config.json"
    config.write_text(config.read_text().replace(str(run.dataset), str((tmp_path / "data").resolve())))
    found = Run.open(tmp_path / "run")
    sure = run.load_part(UNCERTAINTY)[0]
    found.save_part(UNCERTAINTY, sure)  # bound to this run's dataset
    return found


def test_frequencies_and_amplitudes_are_the_motions(result):
    assert sorted(v.hz for v in result.vibrations) == [3.0, 7.5]
    for v in result.vibrations:
        assert v.amplitude.value == pytest.approx(AMPLITUDE, rel=0.1)
        assert np.sqrt(2) * NOISE < v.amplitude.deviation < np.sqrt(2) * DEVIATION
        assert 0 < v.deviation_hz < 0.05
        assert v.damping is None
    assert (result.n_cameras, result.n_timesteps, result.fps, result.unit_scale_m) == (3, 30, 30.0, 0.1)
    assert result.agreement == (0.99, 0.9)


@pytest.mark.parametrize(
    ("hz", "size", "where"), [(5.2, 0.1, "beside"), (7.5, 90.0, "own"), (7.5, 0.1, "model")]
)
def test_what_a_region_shows_is_named_in_a_scene_with_depth_too(copy, hz, size, where):
    """What the model lacks stands beside it; where a small part moves much further than it says, by the region."""
    region = np.zeros((2, 2), bool)
    region[1, 0] = True
    seen = found(hz=hz)
    position = {"centre_px": (9.0, 21.0), "cells": region, "region": region, "box": (0, 16, 16, 32)}
    line = replace(seen.lines[0], amplitude_px=size, **position)
    seen = replace(seen, lines=(line,), movers=(), moves_by_itself=~region & region, size=(32, 32))
    copy.record("look", to_record(seen))
    result = result_of(copy)
    assert sorted(v.hz for v in result.vibrations) == [3.0, 7.5]
    if where == "model":
        assert not result.beside
        assert all(v.amplitude.value < 2 * AMPLITUDE for v in result.vibrations)
        return
    (v,) = result.beside if where == "beside" else result.vibrations[:1]
    assert (v.hz, v.pixels.value) == (hz, size)
    capture = load_capture(copy.dataset)
    at = capture.viewmats[0, :3, :3] @ v.position + capture.viewmats[0, :3, 3]
    assert (capture.Ks[0] @ at)[:2] / at[2] == pytest.approx((9.0, 21.0))
    assert v.amplitude.value == pytest.approx(size * at[2] / capture.Ks[0, 0, 0])
    assert ("seen only in its region" in "\n".join(lines_of(result))) == (where == "beside")


def test_pixels_are_how_far_a_point_lands_apart(result, run):
    """Finite differences of the projection, of the largest among what the cameras see."""
    capture, means = load_capture(run.dataset), run.load_space().means.numpy().astype(float)
    motion = run.load_motion()

    def land(points, i):
        q = (points @ capture.viewmats[i, :3, :3].T + capture.viewmats[i, :3, 3]) @ capture.Ks[i].T
        return q[:, :2] / q[:, 2:]

    for v in result.vibrations:
        (k,) = np.flatnonzero(motion.freqs_hz == v.hz)
        moved = motion.displacement[k].imag.astype(float)  # sine phase, a line
        apart = [land(means + moved, i) - land(means - moved, i) for i in range(3)]
        top = np.linalg.norm(apart, axis=2).max() / 2
        assert 0.75 * top < v.pixels.value <= 1.001 * top
        assert v.pixels.deviation / v.pixels.value == pytest.approx(v.amplitude.deviation / v.amplitude.value)


def test_the_lines_say_it_in_every_unit(result, run):
    lines = lines_of(result)
    text = "\n".join(lines)
    assert len(lines) <= 14
    assert lines[0].endswith("3 fixed cameras, 30 timesteps at 30 Hz, 1 s")
    for v in result.vibrations:
        row = next(line for line in lines if f"{v.hz:.1f}" in line and "px" in line)
        assert f"{with_deviation(v.pixels)} px" in row
        assert f"{with_deviation(v.amplitude)} scene units" in row
        assert f"{with_deviation(v.amplitude.times(100))} mm" in row
    assert "the sun was low" in text
    assert "0.99, 0.9: agreement of two halves" in text
    assert "damping not determined" in text
    assert "closer than 1 Hz" in text
    assert f"--band {result.band[0]:g} {result.band[1]:g}, which --band auto takes" in text


def test_the_next_command_works(result, run, tmp_path):
    words = shlex.split(result.next_command)
    assert words[:3] == ["tg4mm", "render", str(run.path)]
    words[words.index("--out") + 1] = str(tmp_path / "o")
    assert main([*words[1:], "--no-video"]) == 0
    assert len(list((tmp_path / "o").rglob("*.png"))) == 2 * 30


def test_without_its_dataset_a_run_tells_what_it_can(copy):
    shutil.rmtree(copy.dataset)
    found = result_of(copy)
    assert [v.pixels for v in found.vibrations] == [None, None]
    assert found.band is not None
    assert "does not exist" in "\n".join(lines_of(found))


def test_without_uncertainty_no_deviation_is_made_up(copy):
    copy.part_file(UNCERTAINTY).unlink()
    found = result_of(copy)
    assert all(v.amplitude.deviation is None and v.pixels.deviation is None for v in found.vibrations)
    assert (found.noise, found.noise_px) == (None, None)
    assert "the uncertainty of amplitudes" in "\n".join(found.cannot)


def test_what_is_smaller_than_its_own_deviation_is_no_vibration(copy):
    parts, _ = copy.load_part(UNCERTAINTY)
    large = torch.full_like(parts["displacement"], 3 * AMPLITUDE)
    copy.save_part(UNCERTAINTY, parts | {"displacement": large})
    found = result_of(copy)
    assert found.vibrations == ()
    assert found.band is None


@pytest.mark.parametrize("hz", [2.0, 2.4])
def test_a_strong_drift_is_no_vibration_and_is_said(copy, hz):
    """Ten times as strong as the vibrations; a record of one second holds fewer than two and a half periods of it."""
    motion = copy.load_motion()
    drift = [np.concatenate([10 * x[:1], x]) for x in (motion.displacement, motion.rotation)]
    freqs = np.array([hz, *motion.freqs_hz])
    copy.save_motion(with_phasors(motion, freqs_hz=freqs, displacement=drift[0], rotation=drift[1]), {})
    found = result_of(copy)
    assert {v.hz for v in found.vibrations} <= {3.0, 7.5}
    assert found.band is None or found.band[0] > hz
    (line,) = (line for line in found.cannot if "or drifts" in line)
    assert f"the record holds {hz:.2g} periods of it" in line


def test_what_comes_and_goes_is_a_drift(copy):
    """One hump in the record: its frequency is as uncertain as it is large."""
    motion = copy.load_motion()
    t = np.arange(30) / 30
    hump = np.fft.rfft(np.exp(-(((t - 0.4) / 0.12) ** 2) / 2))[1:6] / 15
    shape = 30 * motion.displacement[:1]
    freqs = np.arange(1.0, 6.0)
    wave = np.asarray(hump[:, None, None] * shape).astype(np.complex64)
    copy.save_motion(with_phasors(motion, freqs_hz=freqs, displacement=wave, rotation=0 * wave), {})
    assert not result_of(copy).vibrations


@pytest.mark.parametrize(
    ("said", "bounds"),
    [
        ({}, []),
        ({"picture_gain": 1.4}, []),
        ({"picture_gain": 1.6}, [3.0, 7.5]),
        ({"lower_bound_hz": [3.01]}, [3.0]),
    ],
)
def test_where_the_fit_says_that_more_moves_amplitudes_are_lower_bounds(copy, said, bounds):
    copy.record("motion", said)
    result = result_of(copy)
    assert sorted(v.hz for v in result.vibrations if v.amplitude.is_bound) == bounds
    assert sorted(v.hz for v in result.vibrations if v.pixels.is_bound) == bounds
    assert sum(" > " in line for line in lines_of(result)) == len(bounds)


def test_a_frequency_whose_motion_the_halves_do_not_agree_on_is_said(copy):
    motion = copy.load_motion()
    nothing = motion.displacement[:0]
    figures = {"frequencies_hz": [3.4], "frequency_deviation_hz": [0.002], "notes": ["motion at 3.4 Hz: …"]}
    copy.save_motion(
        with_phasors(motion, freqs_hz=np.zeros(0), displacement=nothing, rotation=nothing), figures
    )
    text = "\n".join(lines_of(result_of(copy)))
    assert "something changes at 3.4000 ± 0.0020 Hz, but its amplitude and direction cannot be deter" in text
    assert "no vibration was found" not in text


def test_nothing_found_and_nothing_to_find(copy, tmp_path):
    still = copy.load_motion()
    copy.save_motion(with_phasors(still, displacement=0 * still.displacement), {})
    found = result_of(copy)
    assert (found.vibrations, found.band) == ((), None)
    assert "no vibration was found" in "\n".join(lines_of(found))
    one, _ = exact_run(tmp_path / "one", n_views=3, n_timesteps=1, size=16)
    lines = lines_of(result_of(one))
    assert lines[0].endswith("a still scene")
    assert "--alpha 0 --split train" in lines[-1]


def test_frequencies_of_cameras_with_clocks_of_their_own_keep_their_deviation(copy):
    stated = {"frequencies_hz": [7.5, 3.0], "frequency_deviation_hz": [0.04, 0.01]}
    copy.save_motion(copy.load_motion(), stated)
    found = result_of(copy)
    assert {v.hz: v.deviation_hz for v in found.vibrations} == {7.5: 0.04, 3.0: 0.01}
    assert all("steady" in v.why_no_damping for v in found.vibrations)


def test_with_one_camera_the_deviation_across_the_sight_counts_in_pixels(copy):
    n = len(copy.load_space())
    capture = load_capture(copy.dataset)
    ray = torch.tensor(capture.viewmats[0, 2, :3], dtype=torch.float32)
    along = 1e-6 * torch.outer(ray, ray) + 1e-10 * torch.eye(3)
    own = {
        "displacement": torch.full((n,), 1e-3),
        "noise": torch.full((n,), 1e-4),
        "covariance": along.expand(n, 3, 3).clone(),
        "along_sight": torch.full((n,), 1e-3),
        "across_sight": torch.full((n,), 1e-5),
    }
    for folder in sorted(copy.dataset.glob("[0-9]*")):
        edit(folder / "transforms_train.json", lambda values: values.update(frames=values["frames"][:1]))
    copy.save_part(UNCERTAINTY, own)
    found = result_of(copy)
    for v in found.vibrations:
        assert v.pixels.deviation / v.pixels.value < 0.3 * v.amplitude.deviation / v.amplitude.value
    assert "towards the only camera" in "\n".join(found.cannot)


def test_what_a_network_turns_single_gaussians_by_does_not_limit_alpha(run, tmp_path):
    """With the preset `paper` phasors of rotation are large where nothing turns; with `modal` they are the scene's."""
    motion, alphas = run.load_motion(), {}
    turned = with_phasors(motion, rotation=np.full_like(motion.rotation, 2.0))
    for preset in ("paper", "modal"):
        made = made_run(tmp_path / preset, run.dataset, run.load_space(), turned, preset)
        alphas[preset] = result_of(made).alpha
    assert alphas["modal"] == 1
    assert alphas["paper"] == result_of(run).alpha > 1


@pytest.mark.parametrize(("hz", "deviation"), [(5.21, 0.01), (5.3, 0.002)])
def test_a_frequency_is_no_surer_than_the_same_line_region_by_region(hz, deviation):
    """Whose own is 5.2 ± .01 Hz."""
    assert at_least_seen(hz, 0.002, found()) == deviation
    assert at_least_seen(hz, 0.5, found()) == 0.5
    assert at_least_seen(hz, 0.002, None) == 0.002
