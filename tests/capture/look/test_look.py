"""A look at films whose truth is exact: what vibrates, where, how much; nothing where nothing vibrates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter, zoom
from skimage import data

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, sliding, texture, write_video
from tg4mm.capture.look import GreyPicture, look, look_at_pictures
from tg4mm.capture.look.look import _is_off_mirror
from tg4mm.capture.video import av_module
from tg4mm.core.errors import CaptureError

WIDTH, HEIGHT, FPS, FRAMES = 160, 112, 30, 180
PLATE = (48, 32, 112, 80)


def film(amplitude_px, motion, noise=3.0, seed=0):
    """A plate before a wall that is still."""
    rng = np.random.default_rng(seed)

    def cloth():
        return texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0))

    shape = np.broadcast_to(np.array(amplitude_px), (HEIGHT, WIDTH, 2))
    layers = [Layer(cloth(), None, [], 0.6), Layer(cloth(), PLATE, [FilmMode(shape, motion)], 0.6)]
    return Film(layers, FPS, FRAMES, noise, seed=seed)


def tone(hz):
    return lambda t: float(np.cos(2 * np.pi * hz * t + 0.7))


def pictures(made):
    for k, grey in enumerate(made.pictures()):
        yield GreyPicture(grey, k / FPS)


def seen(made):
    return look_at_pictures(pictures(made), "a film")


def inside(line_box, centre):
    left, upper, right, lower = line_box
    return left <= centre[0] <= right and upper <= centre[1] <= lower


def test_a_plate_that_vibrates_is_found_where_it_is_with_its_frequency_amplitude_and_direction():
    found = seen(film((0.06, -0.08), tone(5.137)))
    assert len(found.vibrations) == 1
    line = found.vibrations[0]
    assert abs(line.hz - 5.137) < 3 * line.hz_deviation < 0.02
    assert abs(line.amplitude_px - 0.1) < 3 * line.amplitude_deviation_px < 0.03
    assert abs(np.dot(line.direction, (0.6, -0.8))) > 0.98
    assert inside(PLATE, line.centre_px)
    assert line.region.sum() >= 2
    wall = ~line.cells & found.usable
    assert wall.sum() > 0.4 * found.usable.size  # the wall is not said to move
    assert found.composite[np.argmin(np.abs(found.hz - 5.137))] > found.composite_floor


@pytest.mark.parametrize("vibrates", [True, False])
def test_before_an_overexposed_wall_a_plate_vibrates_or_stands(vibrates):
    """Most cells then have no noise at all, by which the plate's own is no motion of another kind."""
    made = film((0.2, -0.1) if vibrates else (0.0, 0.0), tone(5.137))
    wall = np.ones((HEIGHT, WIDTH), bool)
    wall[PLATE[1] : PLATE[3], PLATE[0] : PLATE[2]] = False
    found = look_at_pictures((replace(p, grey=np.where(wall, 255, p.grey)) for p in pictures(made)), "a film")
    assert found.movers == ()
    assert [round(line.hz, 2) for line in found.vibrations] == ([5.14] if vibrates else [])


def plate_before_a_skipped_wall(path, size_px, hz, noise, crf, box):
    """129 frames at 24 Hz of a textured plate that vibrates before a wall without noise, which the codec repeats."""
    wall, plate = data.camera()[100:244, 150:342].astype(float), data.gravel()[:144, :192]
    rng, spectrum, frequencies = np.random.default_rng(1), np.fft.fft(plate), np.fft.fftfreq(192)
    frames = np.repeat(wall[None], 129, 0)
    for k, frame in enumerate(frames):
        turn = np.exp(-2j * np.pi * frequencies * size_px * np.sin(2 * np.pi * hz * k / 24))
        moved = np.fft.ifft(spectrum * turn).real + noise * rng.normal(size=plate.shape)
        frame[box] = moved[box]
    coding = Coding("libx264", 0, 250, crf=crf, preset="medium")
    write_video(path, np.clip(np.rint(frames), 0, 255).astype(np.uint8), 24, coding)
    return look(path)


@pytest.mark.parametrize("size_px", [0.5, 0.0])
def test_a_still_wall_that_the_codec_skips_does_not_outvote_the_plate(tmp_path, size_px):
    """Its cells repeat bit for bit, so their measured noise is nearly zero."""
    found = plate_before_a_skipped_wall(tmp_path / "a.mp4", size_px, 8.29, 0.3, 20, np.s_[36:108, 48:144])
    assert [round(line.hz, 1) for line in found.vibrations] == ([8.3] if size_px else [])
    assert found.smallest[0].best_px > 1e-4  # rounding alone hides less


@pytest.mark.parametrize("seed", [0, 1])
def test_two_lines_that_predicted_frames_alone_do_not_resolve_keep_their_amplitudes(tmp_path, seed):
    """At 7.5 predicted frames per second, 7.9 Hz and its image at 7.1 Hz are one frequency."""
    rows, columns = np.mgrid[4:164, 4:212].astype(float)
    wall, moves, rng = data.brick()[100:268, 100:316].astype(float), columns > 40, np.random.default_rng(seed)
    right, down = (
        size * np.sin(2 * np.pi * hz * np.arange(240) / 30) for size, hz in ((0.3, 3.7), (0.1, 7.9))
    )
    frames = [
        map_coordinates(wall, [rows - b * moves, columns - a * moves], order=3)
        + 1.5 * rng.normal(size=rows.shape)
        for a, b in zip(right, down, strict=True)
    ]
    coding = Coding("libx264", 0, 250, crf=18)
    write_video(tmp_path / "a.mp4", np.clip(np.rint(frames), 0, 255).astype(np.uint8), 30, coding)
    found = look(tmp_path / "a.mp4")
    assert max(line.amplitude_px for line in found.lines) < 0.5  # marked ones, too
    for hz, size_px in ((3.7, 0.3), (7.9, 0.09)):
        nearest = min(found.vibrations, key=lambda line: abs(line.hz - hz))
        assert nearest.hz == pytest.approx(hz, abs=0.02)
        assert nearest.amplitude_px == pytest.approx(size_px, rel=0.35)
    assert found.images_hz == pytest.approx(7.5)


@pytest.mark.parametrize("passes", [False, True])
@pytest.mark.parametrize(
    ("photograph", "noise", "crf", "shape", "seed"),
    [("brick", 2.3, 23, (150, 192, 256), 2), ("rocket", 0.9, 15, (200, 240, 320), 10)],
)
def test_noise_that_a_key_frame_brings_anew_is_nothing_that_passes(
    tmp_path, photograph, noise, crf, shape, seed, passes
):
    """Codecs repeat the noise of a key frame in all that rests, until the next one replaces it.

    With seed 10, one cell in the corner of the picture stands out.
    """
    still = np.atleast_3d(getattr(data, photograph)()).mean(2)
    still = still[-shape[1] :, : shape[2]] if photograph == "brick" else still[: shape[1], : shape[2]]
    frames = still + noise * np.random.default_rng(seed).normal(size=shape)
    for k in range(40 if passes else 0):
        frames[60 + k, 48:96, 4 * k : 4 * k + 32] = data.gravel()[:48, :32]
    coding = Coding("libx264", 0, shape[0] - 50, crf=crf)
    write_video(tmp_path / "a.mp4", np.clip(np.rint(frames), 0, 255).astype(np.uint8), 30, coding)
    found = look(tmp_path / "a.mp4").movers
    assert bool(found) == passes
    assert not passes or (min(m.from_s for m in found) < 2.3 and max(m.until_s for m in found) > 3.0)


@pytest.mark.parametrize(
    ("size_px", "hz", "noise", "crf", "box"),
    [(0.96, 9.52, 0.08, 21, np.s_[24:86, 32:129]), (1.13, 7.59, 0.27, 19, np.s_[36:83, 31:119]),
     (0.62, 8.55, 0.17, 25, np.s_[39:102, 46:146])],
)  # fmt: skip
def test_cells_at_rest_beside_the_plate_do_not_lessen_its_amplitude(tmp_path, size_px, hz, noise, crf, box):
    strongest = plate_before_a_skipped_wall(tmp_path / "a.mp4", size_px, hz, noise, crf, box).vibrations[0]
    assert strongest.hz == pytest.approx(hz, abs=0.02)
    assert strongest.amplitude_px == pytest.approx(size_px, rel=0.2)


def decoded(path, photograph, bump, phase, seed=0):
    """150 grey pictures of a compressed film, in which a bump of a photograph vibrates by 3.7 Hz to left and right."""
    size_px, x, y, width, height = bump
    still = np.atleast_3d(getattr(data, photograph)()).mean(2)
    still = zoom(still, max(640 / still.shape[1], 1), order=1)[:360, :512]
    down, right = np.mgrid[: still.shape[0], : still.shape[1]].astype(np.float32)
    spline = spline_filter(still, 3, output=np.float32, mode="mirror")
    share = np.exp(-((((right - x) / width) ** 2 + ((down - y) / height) ** 2) ** 2))
    box = np.s_[max(y - 2 * height, 0) : y + 2 * height, max(x - 2 * width, 0) : x + 2 * width]
    rng, frames = np.random.default_rng(seed), []
    for k in range(150):
        at = [down[box], right[box] - size_px * np.sin(2 * np.pi * 3.7 * k / FPS + phase) * share[box]]
        moved = still.copy()
        moved[box] = map_coordinates(spline, at, order=3, prefilter=False, mode="mirror")
        frames.append(np.clip(np.rint(moved + 1.5 * rng.normal(size=still.shape)), 0, 255).astype(np.uint8))
    write_video(path, np.stack(frames), FPS, Coding("libx264", 0, crf=23))
    with av_module().open(str(path)) as file:
        return np.stack([frame.to_ndarray(format="gray") for frame in file.decode(video=0)])


def test_of_frames_decoded_from_a_compressed_film_no_vibration_is_named_that_its_order_makes(tmp_path):
    bump, phase = (0.25, 180, 180, 92, 94), 1.4 - np.pi / 2
    shown = decoded(tmp_path / "film.mp4", "brick", bump, phase, seed=1)
    found = look_at_pictures((GreyPicture(grey, k / FPS) for k, grey in enumerate(shown)), "the frames")
    assert min(abs(line.hz - 3.7) for line in found.vibrations) < 0.03
    assert min(abs(line.hz - hz) for line in found.vibrations for hz in (7.5, 15)) > 0.2


def test_what_vibrates_is_not_masked_where_a_codec_changed_most_of_it(tmp_path):
    """Its cells move as their neighbours do, unlike those of a wheel or of leaves."""
    shown = decoded(tmp_path / "film.mp4", "rocket", (0.5, 179, 180, 92, 94), 0.0)
    half = np.rint(shown.reshape(150, 180, 2, 256, 2).mean((2, 4))).astype(np.uint8)
    found = look_at_pictures((GreyPicture(grey, k / FPS) for k, grey in enumerate(half)), "the frames")
    assert any(abs(line.hz - 3.7) < 0.03 and line.amplitude_px > 0.15 for line in found.vibrations)


def test_of_noise_nothing_is_named():
    found = seen(film((0.0, 0.0), tone(5.0), noise=5.0, seed=1))
    assert found.lines == ()
    assert found.movers == ()
    assert found.composite[2:].mean() == pytest.approx(1, abs=0.2)


def test_flicker_is_light_and_no_vibration():
    still = film((0.0, 0.0), tone(5.0), seed=2)
    found = seen(replace(still, light=lambda t: 1 + 0.03 * float(np.cos(2 * np.pi * 7.3 * t))))
    assert found.vibrations == ()
    assert found.light[0].hz == pytest.approx(7.3, abs=0.05)


@pytest.mark.parametrize(("size_px", "depth"), [(0.3, 0.03), (0.05, 0.05)])
def test_what_vibrates_at_the_frequency_of_the_lamps_is_found_beside_them(size_px, depth):
    """A motor at 100 Hz under lamps on the mains: the one is a shift of its place, the other a gain of all."""
    moving = film((size_px, 0.0), tone(7.3), noise=2.0, seed=12)
    found = seen(replace(moving, light=lambda t: 1 + depth * float(np.cos(2 * np.pi * 7.3 * t))))
    assert [tone.hz for tone in found.light] == pytest.approx([7.3], abs=0.05)
    assert [round(line.hz, 1) for line in found.vibrations] == [7.3]
    line = found.vibrations[0]
    assert abs(line.amplitude_px - size_px) < 2 * line.amplitude_deviation_px < 0.4 * size_px
    assert inside(PLATE, line.centre_px)


def test_a_plate_that_vibrates_is_no_light():
    found = seen(film((0.0, 0.3), tone(4.3), noise=1.0, seed=3))
    assert found.light == ()
    assert found.vibrations[0].hz == pytest.approx(4.3, abs=0.01)
    assert found.vibrations[0].amplitude_px == pytest.approx(0.3, rel=0.05)


def test_what_rings_down_is_one_line_with_its_damping():
    decay = 0.02 * 2 * np.pi * 6.2
    found = seen(film((0.0, 0.3), lambda t: float(np.exp(-decay * t) * np.sin(2 * np.pi * 6.2 * t)), seed=4))
    assert len(found.vibrations) == 1
    line = found.vibrations[0]
    assert line.change == "decays"
    assert abs(line.damping - 0.02) < 3 * line.damping_deviation < 0.01
    assert abs(line.amplitude_px - 0.3) < 3 * line.amplitude_deviation_px


@pytest.mark.parametrize("seed", [4, 5])
def test_what_rings_down_in_a_coded_film_has_the_damping_before_compression(tmp_path, seed):
    """The codec takes more of it as it fades, so that it seems to ring down faster."""
    decay = 0.02 * 2 * np.pi * 5.2
    made = film((0.0, 0.4), lambda t: float(np.exp(-decay * t) * np.sin(2 * np.pi * 5.2 * t)), 1.5, seed)
    write_video(tmp_path / "film.mp4", made.pictures(), FPS, Coding("libx264", 0, crf=16))
    line = look(tmp_path / "film.mp4").vibrations[0]
    assert line.decay_per_s > 1.02 * decay  # as the pictures show it
    assert abs(line.damping - 0.02) < 3 * line.damping_deviation < 0.02


def test_what_turns_is_masked_and_does_not_hide_what_vibrates():
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    disc, angle = np.hypot(x - 136, y - 24) < 16, np.arctan2(y - 24, x - 136)

    def wheel(picture, t, k):
        return np.where(disc, 0.3 + 0.25 * np.sign(np.cos(3 * (angle - 2 * np.pi * 2.7 * t))), picture)

    found = seen(replace(film((0.1, 0.0), tone(5.6), seed=5), painters=[wheel]))
    assert [round(line.hz, 1) for line in found.vibrations] == [5.6]
    assert inside(found.movers[0].box, (136, 24))
    assert found.moves_by_itself[1, 8]
    assert not found.moves_by_itself[3, 5]
    assert found.movers[0].hz == pytest.approx(8.1, abs=0.05)


def test_the_edge_of_what_vibrates_is_not_masked_however_little_noise_there_is():
    """It covers and uncovers what is behind, at twice the frequency, which no shift explains."""
    rng, shift = np.random.default_rng(9), 0.4
    dark, bright = (texture(HEIGHT, WIDTH, rng, c, m, (1.5, 4.0)) for c, m in ((0.4, 0.06), (0.1, 0.6)))
    shape = np.broadcast_to([shift, 0.0], (HEIGHT, WIDTH, 2))
    body = Layer(dark, (-8, 24, 56, HEIGHT + 8), [FilmMode(shape, tone(3.7))], 0.3)
    found = seen(Film([Layer(bright, None, [], 0.3), body], FPS, FRAMES, 0.5, seed=9))
    assert found.movers == ()
    assert not found.moves_by_itself.any()
    assert [round(line.hz, 2) for line in found.vibrations] == [3.7]
    assert found.vibrations[0].amplitude_px == pytest.approx(shift, rel=0.05)


@pytest.mark.parametrize(
    ("direction", "phase", "rows"), [((0.0, 1.0), 0.0, 2), ((1.0, 0.0), 1.9, 2), ((1.0, 0.0), np.pi, 1)]
)
def test_a_part_that_moves_at_the_same_frequency_otherwise_is_a_row_of_its_own(direction, phase, rows):
    """In another direction or phase, but for half a period: then it is the other side of one mode."""
    rng, hz, sizes = np.random.default_rng(11), 4.3, (0.4, 0.2)

    def plate(box, towards, size, phase):
        shape = np.broadcast_to(size * np.array(towards), (HEIGHT, WIDTH, 2))
        cloth = texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0))
        return Layer(cloth, box, [FilmMode(shape, lambda t: float(np.cos(2 * np.pi * hz * t + phase)))], 0.6)

    wall = Layer(texture(HEIGHT, WIDTH, rng, 0.3, 0.3, (1.5, 4.0)), None, [], 0.6)
    boxes = (16, 32, 56, 80), (104, 32, 144, 80)
    plates = [plate(boxes[0], (1.0, 0.0), sizes[0], 0.0), plate(boxes[1], direction, sizes[1], phase)]
    found = seen(Film([wall, *plates], FPS, FRAMES, 2.0, seed=11)).vibrations
    assert [round(line.hz, 1) for line in found] == [hz] * rows
    for line, box, size in zip(found, boxes, sizes, strict=False):
        assert inside(box, line.centre_px)
        assert abs(line.amplitude_px - size) < 2 * line.amplitude_deviation_px
    if rows == 2:
        assert not (found[0].cells & found[1].cells).any()
        assert abs(np.dot(found[1].direction, direction)) > 0.98
        own = (p.phase_rad + np.pi * (p.direction[0] + p.direction[1] < 0) for p in found)
        assert np.cos(np.subtract(*own) + phase) > 0.97


def test_the_wall_is_the_background_though_the_plate_has_more_texture():
    """Weighted by texture, half of the motion would be taken for the camera's."""
    rng = np.random.default_rng(6)
    plain = Layer(texture(HEIGHT, WIDTH, rng, 0.08, 0.3, (4.0,)), None, [], 0.6)
    moving = film((0.2, 0.0), tone(3.3), seed=6)
    found = seen(replace(moving, layers=[plain, moving.layers[1]]))
    assert found.vibrations[0].amplitude_px == pytest.approx(0.2, rel=0.1)
    assert inside(PLATE, found.vibrations[0].centre_px)


def test_a_coded_video_needs_nothing_else(tmp_path):
    made, video = film((0.15, 0.0), tone(5.2), seed=7), tmp_path / "plate.mp4"
    write_video(video, made.pictures(), FPS, Coding("libx264", 1_500_000))
    line = look(video).vibrations[0]
    assert abs(line.hz - 5.2) < 3 * line.hz_deviation
    assert abs(line.amplitude_px - 0.15) < 3 * line.amplitude_deviation_px
    slow = look(video, fps=120.0)
    assert slow.rate == pytest.approx(120)
    assert slow.vibrations[0].hz == pytest.approx(4 * line.hz, rel=1e-3)


def test_pictures_that_are_shown_again_are_left_out_and_the_others_have_their_true_times(tmp_path):
    """25 pictures a second stored as 30."""
    made = replace(film((0.2, 0.0), tone(5.2), seed=8), fps=25)
    shown = np.repeat(made.pictures(), np.where(np.arange(FRAMES) % 5 == 2, 2, 1), axis=0)
    write_video(tmp_path / "a.mp4", shown, 30, Coding("libx264", 4_000_000))
    found = look(tmp_path / "a.mp4")
    assert len(found.repeats) == 36
    assert found.rate == pytest.approx(25)
    assert [round(line.hz, 1) for line in found.vibrations] == [5.2]


@pytest.mark.parametrize(("hz", "resolved"), [(3.7, False), (2.4, True), (7.4, False), (5.2, True)])
def test_predicted_frames_alone_do_not_resolve_a_frequency_near_half_their_rate(hz, resolved):
    """Frames that are predicted, every fourth of 30 a second: 3.7 Hz looks like 3.8 Hz among them."""
    assert _is_off_mirror(hz, np.arange(0, 8, 4 / FPS), 8.0) == resolved


def test_what_cannot_be_looked_at_is_said():
    few = [GreyPicture(np.zeros((32, 32), np.uint8), k / FPS) for k in range(10)]
    with pytest.raises(CaptureError, match="a film: holds 10 pictures; at least 24 are needed"):
        look_at_pictures(few, "a film")
    other = [*few, GreyPicture(np.zeros((32, 48), np.uint8), 1.0)]
    with pytest.raises(CaptureError, match="picture 10 has 48×32 pixels, the first 32×32"):
        look_at_pictures(other, "a film")


def test_a_picture_without_texture_or_light_names_nothing():
    black = [GreyPicture(np.zeros((64, 64), np.uint8), k / FPS) for k in range(60)]
    found = look_at_pictures(black, "a film")
    assert found.lines == ()
    assert not found.usable.any()


@pytest.mark.parametrize("size_px", [1.5, 3.0])
def test_a_plate_that_moves_by_pixels_is_found_with_its_amplitude(size_px):
    """Its mean picture is smeared: by small shifts it moves "by itself", at twice its frequency."""
    rng, hz, towards = np.random.default_rng(8), 4.13, np.array([0.8, 0.6])
    surface = texture(48 + 32, 64 + 32, rng, 0.4, 0.4, (1.2, 3.0))
    plate = sliding(surface, (80, 56), lambda t: size_px * np.cos(2 * np.pi * hz * t + 0.7) * towards)
    still = film((0.0, 0.0), lambda t: 0.0, seed=8)
    line = seen(replace(still, painters=[plate])).vibrations[0]
    assert abs(line.hz - hz) < 3 * line.hz_deviation < 0.01
    assert line.amplitude_px == pytest.approx(size_px, rel=0.05)
    assert abs(line.amplitude_px - size_px) < 2 * line.amplitude_deviation_px
    assert abs(np.dot(line.direction, towards)) > 0.99
    assert inside(PLATE, line.centre_px)


def test_what_b_frames_keep_of_a_line_is_known(tmp_path):
    rng, (h, w) = np.random.default_rng(1), (120, 160)
    cloths = [texture(h, w, rng, 0.3, 0.15, (1.5, 4.0, 12.0)) for _ in range(2)]
    plate = FilmMode(np.broadcast_to([0.2, 0.1], (h, w, 2)), lambda t: float(np.cos(2 * np.pi * 5.3 * t)))
    layers = [Layer(cloths[0], None, [], 0.6), Layer(cloths[1], (40, 30, 120, 90), [plate], 0.6)]
    pictures, shares = Film(layers, 30, 150, 2.0).pictures(), []
    for crf in (0, 24):
        write_video(tmp_path / "f.mp4", pictures, 30, Coding("libx264", 0, crf=crf))
        (line,) = look(tmp_path / "f.mp4").vibrations
        shares.append(line.between_share)
    assert shares[0] == 1
    assert shares[1] < 0.9
