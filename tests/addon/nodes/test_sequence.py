"""Numbered static files play one after another, whatever their numbers of Gaussians."""

from dataclasses import replace

import numpy as np
import pytest

from tests.addon.conftest import some_splat
from tg4mm.core.splatfile import SplatFile, positions_at, read_splat, rotations_at, write_splat

bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")

from tests.addon.playing import (  # noqa: E402
    drawn_whole,
    import_files,
    import_splat,
    matrices,
    places,
    setter,
    transforms,
)

COUNTS = (7, 12, 3, 9)


@pytest.fixture
def frames(tmp_path):
    """beat_0008.ply … beat_0011.ply, of different sizes, and neighbours that are no part of them."""
    paths = [tmp_path / f"beat_{i + 8:04d}.ply" for i in range(len(COUNTS))]
    for i, (path, n) in enumerate(zip(paths, COUNTS, strict=True)):
        one = some_splat(n, (), degree=i % 2)
        still = SplatFile.static(one.means + i, one.quats, one.scales, one.opacities, one.sh)
        write_splat(path, still)
    for name in ("beat_0013.ply", "other_0012.ply", "beat.ply"):
        write_splat(tmp_path / name, some_splat(2, ()))
    return paths


def check(obj, paths, shown):
    for frame, i in shown.items():
        np.testing.assert_allclose(places(obj, frame), read_splat(paths[i]).means, atol=1e-6)


def test_one_file_brings_its_run(extension, frames):
    obj = import_splat(frames[2])
    drawn_whole(extension, obj)
    check(obj, frames, {1: 0, 2: 1, 3: 2, 4: 3, 2.75: 1, 0: 0, 9: 3})
    scene = bpy.context.scene
    assert (scene.frame_start, scene.frame_end) == (1, 4)
    assert obj.name == "beat"
    assert not [other for other in scene.objects if other is not obj]


def test_chosen_files_play_in_the_order_of_their_numbers(extension, frames):
    obj = import_files([frames[3], frames[0]])
    drawn_whole(extension, obj)
    check(obj, [frames[0], frames[3]], {1: 0, 2: 1})


def test_speed_first_frame_and_loop(extension, frames):
    obj = import_splat(frames[0])
    drawn_whole(extension, obj)
    put, names = setter(extension, obj), extension.names
    put(names.FIRST, 11.0)
    put(names.SPEED, 0.5)
    check(obj, frames, {11: 0, 12: 0, 13: 1, 17: 3, 30: 3})
    put(names.LOOP, True)
    check(obj, frames, {11: 0, 19: 0, 21: 1, 10: 3})


def test_files_that_move_are_no_frames(extension, tmp_path):
    paths = [tmp_path / f"bell_{i}.ply" for i in range(2)]
    for path in paths:
        write_splat(path, some_splat())
    obj = import_splat(paths[0])
    assert obj.name == "bell_0"
    import_files(paths)
    assert len(bpy.context.scene.objects) == 3


def test_an_import_tells_which_numbers_are_missing(extension, frames):
    missing = extension.io.sequence.missing_beside
    assert missing(frames[0]) == missing(frames[3]) == [12]  # number 13 follows
    frames[0].with_name("beat_0013.ply").unlink()
    assert missing(frames[0]) == missing(frames[0].with_name("beat.ply")) == []
    frames[1].unlink()
    assert missing(frames[3]) == [9]
    loaded = extension.io.import_splat.load(
        [frames[2]], bpy.context.collection, True, 1000, lambda part: None
    )
    assert loaded.message == "2 frames of up to 9 Gaussians; missing file numbers: 9"


def walk(tmp_path, count=16, n=23, name="step_{:03d}.ply"):
    """Frames of the same Gaussians, which move and turn with periods of 8 and 4 frames; their paths."""
    one = some_splat(n, (3.0, 6.0))
    moving = replace(one, fps=24.0)
    paths = []
    for t in range(count):
        means, quats = positions_at(moving, t).astype(np.float32), rotations_at(moving, t).astype(np.float32)
        still = SplatFile.static(means, quats, one.scales, one.opacities, one.sh)
        paths.append(tmp_path / name.format(t))
        write_splat(paths[-1], still)
    return paths, moving


@pytest.mark.parametrize("name", ["step_{:03d}.ply", "{}.ply", "time_{:05d}.compressed.ply"])
def test_files_that_share_their_gaussians_are_motion_that_is_magnified(extension, tmp_path, name):
    paths, moving = walk(tmp_path, name=name)
    bpy.context.scene.render.fps = 24
    obj, names = import_splat(paths[5]), extension.names
    drawn_whole(extension, obj)
    assert list(obj[names.FREQUENCIES]) == pytest.approx([3.0, 6.0])
    for t in (0, 3, 7, 15):
        np.testing.assert_allclose(places(obj, 1 + t), positions_at(moving, t), atol=1e-4)
        turned = matrices(rotations_at(moving, t)) * moving.scales[:, None]
        np.testing.assert_allclose(transforms(obj, 1 + t)[:, :3, :3], turned, atol=4e-3)
    put = setter(extension, obj)
    for input_, value in ((names.ALPHA, 5.0), (names.LOW, 5.0), (names.HIGH, 7.0)):
        put(input_, value)
    np.testing.assert_allclose(places(obj, 4), positions_at(moving, 3, 5.0, (5.0, 7.0)), atol=1e-3)


def test_what_changes_besides_the_motion_is_said(extension, tmp_path):
    paths, load = walk(tmp_path)[0], extension.io.import_splat.load
    kept = "colours stay as in the first file, though they change by up to 7%: without Find Motion they play"
    modes = "16 frames of 23 Gaussians, as 2 modes"
    for change, said in ((0.0, modes), (0.25, f"{modes}; {kept}"), (2.0, "16 frames of up to 23 Gaussians")):
        splat = read_splat(paths[5])
        splat.sh[3] += np.float32(change)
        write_splat(paths[5], splat)
        done = load(paths, bpy.context.collection, True, 1000, lambda part: None, fps=24.0)
        assert done.message == said


def test_a_folder_is_its_sequence(extension, tmp_path):
    walk(tmp_path)
    obj = import_splat(tmp_path)
    assert (obj.name, obj[extension.names.TIMESTEPS]) == ("step", 16)
    write_splat(tmp_path / "other_1.ply", some_splat(4, ()))
    with pytest.raises(RuntimeError, match="holds 2 numbered sequences: choose a file of one"):
        import_splat(tmp_path)


def test_other_gaussians_or_another_order_are_played_as_frames(extension, tmp_path):
    paths, _ = walk(tmp_path)
    mixed = read_splat(paths[3])
    order = np.roll(np.arange(len(mixed)), 1)
    parts = (mixed.means, mixed.quats, mixed.scales, mixed.opacities, mixed.sh)
    write_splat(paths[3], SplatFile.static(*(part[order] for part in parts)))
    obj = import_splat(paths[0])
    assert extension.nodes.scene.sequence_frames(obj) is not None
    drawn_whole(extension, obj)
    check(obj, paths, {1: 0, 4: 3, 16: 15})
    paths[3].unlink()
    paths[4].unlink()
    assert extension.nodes.scene.sequence_frames(import_splat(paths[0], motion=False)) is not None
