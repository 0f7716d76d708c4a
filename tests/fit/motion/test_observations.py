"""What the motion stage sees of a capture: which cameras stay put, on which clock, their pictures by strips."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import moving_pictures
from tg4mm.capture import ImageStack
from tg4mm.core.errors import CaptureError
from tg4mm.fit.motion.observations import fixed_cameras, frames_of, observe

STEP = 1 / 30  # s


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
        with pytest.raises(
            CaptureError, match=r"cameras are synchronous, but their times differ .* 20, .* 19\)"
        ):
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
