"""What the motion stage sees of a capture: which cameras stay put, on which clock, their pictures by strips.

How much of a recording is read: all of a short one, squares of a long one, and what lies around a region never.

What one pose's pictures show of motion: adjoint and normal operator belong to it, and each row has its own time.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.fit.motion.scenes import inner, problem, two_cameras, weights_of
from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import moving_pictures
from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import Window
from tg4mm.core.errors import CaptureError, Tg4mmError
from tg4mm.core.even_clock import delayed, later
from tg4mm.fit.motion.config import MotionConfig, checked
from tg4mm.fit.motion.observation_model import ObservationModel, project
from tg4mm.fit.motion.observations import PosedFrames, fixed_cameras, frames_of, note_on, observe, window_on

STEP = 1 / 30  # s
TIMES = np.arange(80) / 20


def captured(ids, steps, times=None, kind=""):
    data, _, _ = moving_pictures(1, len(ids))
    capture, _ = capture_of(ids, steps, data)
    if times is not None:
        capture = replace(capture, times_s=np.array(times))
    return replace(capture, kind=kind or capture.kind)


def rig(n_cameras, n_timesteps):
    ids = list(range(n_cameras)) * n_timesteps
    return captured(ids, sorted(list(range(n_timesteps)) * n_cameras))


class TestFixedCameras:
    def test_cameras_with_less_than_half_of_the_most_pictures_are_left_out(self):
        ids = [0] * 8 + [1] * 4 + [2] * 3
        steps = [*range(8), *range(4), *range(3)]
        assert [len(f.rows) for f in fixed_cameras(captured(ids, steps))] == [8, 4]

    def test_pictures_without_a_time_show_the_scene_at_rest(self):
        """A tripod's video, and photographs from elsewhere, of which two are from one place."""
        ids = [0] * 5 + [1, 2, 2]
        times = [*(np.arange(5) * STEP), np.nan, np.nan, np.nan]
        capture = captured(ids, [0, 1, 2, 3, 4, 0, 0, 0], times, "tripod")
        clock, frames = frames_of(capture)
        assert clock == "synchronous"
        assert [list(f.rows) for f in frames] == [[0, 1, 2, 3, 4]]
        assert not observe(capture, ImageStack(np.zeros((8, 2, 2, 4), np.uint8))).is_whole


class TestClock:
    def clock(self, times, kind="rig"):
        ids = [c for c, own in enumerate(times) for _ in own]
        steps = [k for own in times for k in range(len(own))]
        return frames_of(captured(ids, steps, list(np.concatenate(times)), kind))[0]

    def test_the_same_times_are_synchronous_though_frames_lack(self):
        dropped = np.delete(np.arange(21), 9) * STEP
        assert self.clock([dropped, dropped]) == "synchronous"
        assert self.clock([dropped], "tripod") == "synchronous"

    def test_the_same_regular_times_are_synchronous(self):
        times = np.arange(20) * STEP
        assert self.clock([times, times]) == "synchronous"
        jitter = 0.05 * STEP * np.random.default_rng(0).uniform(-1, 1, (2, 20))
        assert self.clock(list(times + jitter)) == "synchronous"
        assert self.clock([times + 7.0, times + 7.0]) == "synchronous"  # a clock that does not begin at zero

    @pytest.mark.parametrize("what", ["begun later", "a dropped frame", "another number", "other steps"])
    def test_others_are_independent(self, what):
        times = np.arange(20) * STEP
        other = {
            "begun later": times + 0.2 * STEP,
            "a dropped frame": np.delete(np.arange(21), 9) * STEP,
            "another number": times[:-1],
            "other steps": times * 1.01,
        }[what]
        assert self.clock([times, other]) == "independent"
        dropped = np.delete(np.arange(21), 9) * STEP
        assert self.clock([dropped, dropped[:-1]]) == "independent"

    def test_clocks_that_are_said_to_be_independent_are_though_their_times_agree(self):
        """A rig of phones: every video begins at 0."""
        times = np.arange(20) * STEP
        capture = captured([0] * 20 + [1] * 20, [*range(20)] * 2, [*times, *times], "rig")
        assert frames_of(capture)[0] == "synchronous"
        assert frames_of(replace(capture, clocks="independent"))[0] == "independent"
        alone = captured([0] * 20, [*range(20)], [*times], "tripod")
        assert frames_of(replace(alone, clocks="independent"))[0] == "synchronous"

    def test_cameras_said_to_be_synchronous_that_are_not_are_refused_with_their_counts(self):
        times = np.arange(20) * STEP
        capture = captured([0] * 20 + [1] * 19, [*range(20), *range(19)], [*times, *times[:-1]], "rig")
        assert frames_of(capture)[0] == "independent"
        said = r"cameras are synchronous, but their times differ .* 20, .* 19\)"
        with pytest.raises(CaptureError, match=said):
            frames_of(replace(capture, clocks="synchronous"))

    def test_a_camera_with_few_pictures_is_left_out_by_name(self):
        times = np.arange(20) * STEP
        capture = captured([0] * 20 + [1] * 5, [*range(20), *range(5)], [*times, *times[:5]], "rig")
        left_out = capture.paths[20].stem
        with pytest.warns(UserWarning, match=f"{left_out}: left out: fewer than half"):
            seen = observe(capture, ImageStack(np.zeros((25, 2, 2, 4), np.uint8)))
        assert len(seen.frames) == 1

    def test_a_camera_that_moves_has_a_pose_for_each_picture(self):
        order = [3, 0, 2, 1, 4, 7, 6, 5, 8, 9]
        times = [*(np.array(order) * STEP), np.nan]
        clock, frames = frames_of(captured(list(range(11)), [*order, 0], times, "handheld"))
        assert clock == "moving"
        assert [f.rows.tolist() for f in frames] == [[k] for k in (1, 3, 2, 0, 4, 7, 6, 5, 8, 9)]
        assert frames[0].viewmat[0, 3] == 1.0

    def test_too_few_pictures_of_a_moving_camera_are_an_error_with_their_number(self):
        capture = captured([0, 1, 2, 3], [0, 1, 2, 3])
        match = r"\A/data: no camera is fixed, and 4 pictures have a time, too few to show motion; [^\n]*\Z"
        with pytest.raises(CaptureError, match=match):
            frames_of(capture)


def filmed(n, height, width):
    data, _, _ = moving_pictures(1, n)
    capture, images = capture_of([0] * n, list(range(n)), data)
    return replace(capture, height=height, width=width), images


@pytest.mark.parametrize(
    ("n", "size", "factor"),
    [(600, (720, 1280), 1), (600, (1080, 1920), 2), (600, (2160, 3840), 3), (60, (2160, 3840), 2)],
)
def test_a_long_recording_of_large_pictures_is_read_smaller(n, size, factor):
    capture, _ = filmed(n, *size)
    window = window_on(capture, MotionConfig())
    assert (1 if window is None else window.factor) == factor
    assert window_on(capture, MotionConfig(reduce="1")) is None
    assert window_on(capture, MotionConfig(reduce="4")).size == (size[0] // 4, size[1] // 4)


def test_a_region_is_read_whole_with_what_lies_around():
    capture, _ = filmed(600, 2160, 3840)
    moves = np.zeros((2160, 3840), bool)
    moves[400:900, 900:1500] = True
    window = window_on(capture, MotionConfig(), moves)
    assert (window.factor, window.size, window.top, window.left) == (1, (1100, 1200), 100, 600)


@pytest.mark.parametrize("text", ["0", "1.5", "-2", "17", "two"])
def test_what_is_no_factor_is_refused(text):
    with pytest.raises(Tg4mmError, match=r"motion.reduce is .* whole number, 1 to 16"):
        checked(MotionConfig(reduce=text))


def test_rows_of_a_region_keep_their_times():
    capture, images = filmed(20, 4, 5)
    capture = replace(capture, readout_s=0.02, kind="flat")
    whole, part = (observe(capture, images, w).frames[0] for w in (None, Window(2, 0, 2, 5, 1)))
    row = 3  # of the picture, the second of the region
    of_whole = whole.times_s + whole.readout_s * ((row + 0.5) / 4 - 0.5)
    of_part = part.times_s + part.readout_s * ((row - 2 + 0.5) / 2 - 0.5)
    assert np.allclose(of_whole, of_part)


@pytest.mark.parametrize(("fineness", "loss"), [(8.0, 1.0), (1.0, 4.0)])
def test_what_averaging_costs_is_estimated_from_the_texture(fineness, loss):
    """Coarse texture loses nothing; of white noise a sixteenth of the slopes' squares stays."""
    rng = np.random.default_rng(0)
    n, height, width = 12, 160, 160
    cells = rng.uniform(60, 190, (int(height / fineness) + 2, int(width / fineness) + 2))
    y, x = (np.arange(s) / fineness for s in (height, width))
    places, order = np.meshgrid(y, x, indexing="ij"), 3 if fineness > 1 else 0
    rest = map_coordinates(cells, places, order=order, mode="nearest")
    data = np.full((n, height, width, 4), 255, np.uint8)
    data[..., :3] = (rest[None, ..., None] + rng.normal(0, 4, (n, height, width, 3))).round().clip(0, 255)
    capture, images = capture_of([0] * n, list(range(n)), data)
    note = note_on(capture, images, window_on(capture, MotionConfig(reduce="2")))
    stated = float(note.split("about ")[1].split(" times")[0])
    assert stated == pytest.approx(loss, rel=0.15)


def frames(readout_s=0.0):
    _, (camera, _) = two_cameras()
    return PosedFrames("", camera.viewmat, camera.K, np.arange(len(TIMES)), TIMES, readout_s)


@pytest.mark.parametrize("nuisance", [None, slice(0, 6), slice(0, 12)], ids=["none", "exposure", "all"])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_adjoint_is_the_transpose_and_the_normal_operator_both(nuisance, weighted):
    p = problem(nuisance=nuisance or slice(0, 0))
    weights = weights_of(p)[0] if weighted else None
    model = ObservationModel.of(frames(), p.nuisances[0], p.means[0], weights)
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2, p.n_gaussians, 6)).astype(np.float32)
    y = rng.normal(size=(2, *p.means[0].shape)).astype(np.float32)
    shown = model.apply(x)
    of_pixels = y if weights is None else y * weights[..., None]
    assert inner(shown, of_pixels) == pytest.approx(inner(x, model.adjoint(y)), rel=1e-3)
    normal = model.normal(x)
    scale = np.abs(normal).max()
    np.testing.assert_allclose(normal, model.adjoint(shown), atol=2e-4 * scale)
    if nuisance is not None:
        columns = p.nuisances[0].columns(p.means[0])
        plain = replace(model, projection=None)
        assert np.abs(model.adjoint(columns)).max() < 1e-3 * np.abs(plain.adjoint(columns)).max()


@pytest.mark.parametrize("hz", [0.7, 3.1, 8.0])
def test_rows_that_are_read_one_after_another_show_what_all_at_once_would(hz):
    """A swing read over 40 ms: without the rows' times the last row's phase is off by up to two radians."""
    height, readout = 16, 0.04
    late = readout * ((np.arange(height) + 0.5) / height - 0.5)
    swing = np.cos(2 * np.pi * hz * (TIMES[:, None] + late))
    strip = np.repeat(swing[:, :, None, None], 3, 3).astype(np.float32)
    functions = np.stack([np.cos(2 * np.pi * hz * TIMES), -np.sin(2 * np.pi * hz * TIMES)]) / 40
    by_rows = project(frames(readout), height, slice(0, height), strip, functions)[..., 0, 0]
    at_once = project(frames(), height, slice(0, height), strip, functions)[..., 0, 0]
    phase = np.angle(by_rows[0] + 1j * by_rows[1])
    assert np.ptp(phase) < 0.1 * np.ptp(2 * np.pi * hz * late)
    np.testing.assert_allclose(np.hypot(*by_rows), 1, atol=0.05)
    phases = np.angle(at_once[0] + 1j * at_once[1])
    assert np.ptp(phases) == pytest.approx(2 * np.pi * hz * np.ptp(late), rel=0.1)
    part = project(frames(readout), height, slice(4, 9), strip[:, 4:9], functions)[..., 0, 0]
    np.testing.assert_allclose(part, by_rows[:, 4:9], atol=1e-6)


def test_a_delay_of_whole_frames_moves_the_samples():
    series = np.random.default_rng(1).normal(size=(2, 80))
    np.testing.assert_allclose(delayed(series, 0), series, atol=1e-12)
    np.testing.assert_allclose(delayed(series, 1)[:, 20:-20], series[:, 21:-19], atol=1e-12)


def test_of_uneven_times_functions_are_interpolated_between_them():
    times = TIMES + np.where(np.arange(80) % 7 == 3, 0.02, 0.0)
    functions = np.stack([np.cos(2 * np.pi * 2.0 * times), np.ones(80)])
    found = later(times, functions, 0.013)[:, 2:-2]
    np.testing.assert_allclose(found[0], np.cos(2 * np.pi * 2.0 * (times + 0.013))[2:-2], atol=0.01)
    np.testing.assert_allclose(found[1], 1, atol=1e-9)
    assert later(times, functions[:0], 0.013).shape == (0, 80)
