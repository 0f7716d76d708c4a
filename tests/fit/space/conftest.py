"""A small scene at rest, for all tests of the space stage."""

import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.space import rest_views
from tg4mm.run import Run


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """One timestep (nothing has moved yet) from 10 training cameras and 3 others."""
    path = tmp_path_factory.mktemp("space") / "data"
    make_synthetic_dataset(path, n_views=10, n_timesteps=1, size=48, alphas=(), n_test=3)
    return path


@pytest.fixture(scope="session")
def views(data):
    capture = load_capture(data)
    return rest_views(capture, load_images(capture))


@pytest.fixture(scope="session")
def points(data):
    found = load_capture(data).points
    assert found is not None
    return found


@pytest.fixture
def new_run(data, tmp_path):
    """A fresh run folder each time it is called."""
    return lambda: Run.create(tmp_path / f"run{len(list(tmp_path.iterdir()))}", data, "modal", {})
