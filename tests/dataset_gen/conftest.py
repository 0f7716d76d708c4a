"""A set with a report."""

import pytest


@pytest.fixture(scope="session")
def plane(tmp_path_factory):
    """A whole set of tests/dataset_gen/planes.py."""
    from tests.dataset_gen.planes import Plane  # needs the packages of the report

    made = Plane(tmp_path_factory.mktemp("set") / "plane_3Hz_0_02")
    made.write(unit_scale_m=0.1, modes=[{"name": "sway", "kind": "rigid"}, {"name": "heave"}])
    made.truth()
    return made.root


@pytest.fixture(scope="session")
def page(plane):
    """The report of `plane`."""
    from dataset_gen.report import write_report

    return write_report(plane).read_text(encoding="utf-8")
