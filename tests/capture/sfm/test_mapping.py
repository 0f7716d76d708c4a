"""COLMAP's mapper as the program calls it."""

import numpy as np
import pytest
from PIL import Image

from tg4mm.capture.sfm.engine import colmap, opened
from tg4mm.capture.sfm.mapping import adjust, best_model

pytest.importorskip("pycolmap")
SIZE, FOCAL = (600, 450), 500.0


def test_an_adjustment_writes_no_log_of_its_own(capfd):
    c = colmap("this test")
    options = c.SyntheticDatasetOptions()
    options.num_frames_per_rig, options.num_points3D = 5, 50
    model = c.synthesize_dataset(options)
    adjust(model, 1)
    c.logging.info("a log line of COLMAP")
    assert capfd.readouterr() == ("", "")


def matched(folder, centres, rng):
    """Names of pictures, whose matches are in a database: cameras at `centres` see 500 points 3 to 6 units ahead."""
    c = colmap("this test")
    points = rng.uniform([-1.2, -0.9, 3], [1.2, 0.9, 6], (500, 3))
    names = [f"{i:02d}.png" for i in range(len(centres))]
    for name in names:
        Image.new("RGB", SIZE).save(folder / name)
    opened(folder / "database.db").__exit__()
    c.import_images(folder / "database.db", folder, c.CameraMode.SINGLE, names, c.ImageReaderOptions())
    with opened(folder / "database.db") as db:
        ids = [db.read_image_with_name(name).image_id for name in names]
        for i, centre in zip(ids, centres, strict=True):
            seen = points - [*centre, 0]
            pixels = FOCAL * seen[:, :2] / seen[:, 2:] + np.array(SIZE) / 2
            db.write_keypoints(i, (pixels + rng.normal(0, 0.3, pixels.shape)).astype(np.float32))
        for k, i in enumerate(ids):
            for j in ids[k + 1 :]:
                geometry = c.TwoViewGeometry()
                geometry.config = c.TwoViewGeometryConfiguration.CALIBRATED
                geometry.inlier_matches = np.repeat(np.arange(len(points), dtype=np.uint32)[:, None], 2, 1)
                db.write_two_view_geometry(i, j, geometry)
    return names


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_that_hardly_moves_is_placed(seed, tmp_path):
    """Views that differ by 2.5 degrees at most, less than COLMAP asks of the pair to start from."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-0.07, 0.07, (6, 2))
    names = matched(tmp_path, centres, rng)
    model = best_model(tmp_path / "database.db", tmp_path, names, 0, 1)
    assert model.num_reg_images() == 6
    found = np.stack([model.find_image_with_name(name).projection_center() for name in names])
    across = (found - found.mean(0)) @ np.linalg.svd(found - found.mean(0))[2][:2].T
    true = centres - centres.mean(0)
    left = true - across @ np.linalg.lstsq(across, true, rcond=None)[0]
    assert np.linalg.norm(left) < 0.2 * np.linalg.norm(true)
