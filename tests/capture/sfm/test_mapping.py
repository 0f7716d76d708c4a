"""COLMAP's mapper as the program calls it."""

import pytest

from tg4mm.capture.sfm.engine import colmap
from tg4mm.capture.sfm.mapping import adjust

pytest.importorskip("pycolmap")


def test_an_adjustment_writes_no_log_of_its_own(capfd):
    c = colmap("this test")
    options = c.SyntheticDatasetOptions()
    options.num_frames_per_rig, options.num_points3D = 5, 50
    model = c.synthesize_dataset(options)
    adjust(model, 1)
    c.logging.info("a log line of COLMAP")
    assert capfd.readouterr() == ("", "")
