"""Masks: what the scene at rest is fitted to, and where motion may be."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture
from tg4mm.capture.pictures import mask_of, region_mask
from tg4mm.cli import main
from tg4mm.core.errors import CaptureError
from tg4mm.run import Run
from tg4mm.show.render.image import render_image

SIZE = 32


def write(path, white):
    Image.fromarray(np.where(white, 255, 0).astype(np.uint8)).save(path)
    return path


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Twelve views of one timestep with the left half of every picture painted red, as one nerfstudio file."""
    root = tmp_path_factory.mktemp("masks") / "still"
    make_synthetic_dataset(root, n_views=12, n_timesteps=1, size=SIZE, alphas=())
    file = json.loads((root / "000" / "transforms_train.json").read_text())
    for i, frame in enumerate(file["frames"]):
        path = next((root / "000" / "train").glob(f"{Path(frame['file_path']).name}.png"))
        picture = np.array(Image.open(path).convert("RGBA"))
        picture[:, :16] = (255, 0, 0, 255)
        out = root / "images" / f"{i}.png"
        out.parent.mkdir(exist_ok=True)
        Image.fromarray(picture).save(out)
        frame["file_path"], frame["mask_path"] = f"images/{i}.png", "right.png"
    write(root / "right.png", np.arange(SIZE)[None] * np.ones((SIZE, 1)) >= 16)
    for path in (root / "000", root / "scene.json"):
        path.rename(root.parent / path.name)
    (root / "transforms.json").write_text(json.dumps(file))
    return root


def train(root, out, *options):
    fast = ["--set", "space.iterations=150", "--set", "space.max_gaussians=400"]
    return main(["train", str(root), "--out", str(out), *fast, *options])


def error(run, root):
    """The error of the left half of a view, against the picture before it was painted."""
    capture = load_capture(root)
    shown = render_image(Run.open(run).load_space(), capture.viewmats[0], capture.Ks[0], SIZE, SIZE)
    path = root.parent / "000" / "train" / f"{names(root)[0]}.png"
    picture = np.array(Image.open(path).convert("RGBA")) / 255
    original = picture[..., :3] * picture[..., 3:] + 1 - picture[..., 3:]
    return float(np.abs(np.asarray(shown)[..., :3] - original)[:, :16].mean())


def names(root):
    file = json.loads((root.parent / "000" / "transforms_train.json").read_text())
    return [Path(frame["file_path"]).name for frame in file["frames"]]


def test_what_a_mask_leaves_out_is_not_fitted(still, tmp_path):
    assert train(still, tmp_path / "masked") == 0
    file = json.loads((still / "transforms.json").read_text())
    for frame in file["frames"]:
        del frame["mask_path"]
    plain = still.parent / "plain"
    plain.mkdir()
    (plain / "images").mkdir()
    for path in (still / "images").iterdir():
        (plain / "images" / path.name).write_bytes(path.read_bytes())
    (plain / "transforms.json").write_text(json.dumps(file))
    assert train(plain, tmp_path / "plain") == 0
    assert error(tmp_path / "masked", still) < 0.3 * error(tmp_path / "plain", still)


def test_motion_is_where_it_may_be(tmp_path, capsys):
    """A post sways and a ball goes to and fro before one camera; only where the post is may anything move."""
    root = tmp_path / "data"
    scene = {"n_views": 1, "n_timesteps": 24, "size": SIZE, "freqs": (3.0, 7.5), "amplitude": 0.03}
    true, _ = make_synthetic_dataset(root, **scene, alphas=())
    write(tmp_path / "nothing.png", np.zeros((SIZE, SIZE), bool))
    write(tmp_path / "small.png", np.ones((8, 9), bool))
    for option, text, message in (
        ("--region", str(tmp_path / "nothing.png"), "the mask is empty"),
        ("--region", str(tmp_path / "small.png"), "the mask is 9×8 pixels, its picture 32×32"),
        ("--mask", "0,0 5,5", "has 2 corners"),
        ("--mask", "nowhere.png", "is neither a mask's file nor a polygon"),
    ):
        assert train(root, tmp_path / "run", option, text) == 2
        assert message in (said := capsys.readouterr().err)
        assert said.count("\n") == 1
    assert not (tmp_path / "run").exists()
    capture = load_capture(root)
    places = true.means.numpy()
    at = pixels(capture, places[is_post(places)])
    (x0, y0), (x1, y1) = at.min(0) - 2, at.max(0) + 2
    moved = []
    for name, options in (("all", ()), ("part", ("--region", f"{x0},{y0} {x1},{y0} {x1},{y1} {x0},{y1}"))):
        assert train(root, tmp_path / name, *options) == 0
        run = Run.open(tmp_path / name)
        motion, means = run.load_motion(), run.load_space().means.numpy()
        across = motion.displacement @ capture.viewmats[0][:2, :3].T  # what one camera tells
        size = np.abs(across).max((0, 2))
        moved.append([np.quantile(size[some], 0.8) for some in (is_post(means), means[:, 0] > 0.2)])
    assert moved[1][0] > 0.6 * moved[0][0]
    assert moved[1][1] < 0.6 * moved[0][1]  # what no picture tells moves with its neighbours


def is_post(means):
    return (means[:, 0] < 0) & (means[:, 2] > 0.2)


def pixels(capture, means):
    """[N, 2] in the first camera's picture."""
    seen = (means @ capture.viewmats[0][:3, :3].T + capture.viewmats[0][:3, 3]) @ capture.Ks[0].T
    return seen[:, :2] / seen[:, 2:]


def test_masks_of_colmap_and_what_is_wrong_with_them(tmp_path):
    from tests.helpers.colmap import CAMERAS, IMAGES, POINTS, pictures

    root = pictures(tmp_path / "colmap")
    (root / "sparse" / "0").mkdir(parents=True)
    for name, content in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (root / "sparse" / "0" / f"{name}.txt").write_text(content)
    (root / "masks").mkdir()
    write(root / "masks" / "b.png.png", np.arange(12)[None] * np.ones((8, 1)) < 4)
    capture = load_capture(root)
    assert mask_of(capture, 0) is None
    assert mask_of(capture, 2).sum() == 32
    write(root / "masks" / "b.png.png", np.ones((9, 12), bool))
    with pytest.raises(CaptureError, match="the mask is 12×9 pixels, its picture 12×8"):
        mask_of(load_capture(root), 2)


def test_a_polygon_holds_the_pixels_in_it():
    mask = region_mask("2,1 6,1 6,5 2,5", (10, 8))
    assert mask[1:5, 2:6].all()
    assert mask.sum() <= 25
