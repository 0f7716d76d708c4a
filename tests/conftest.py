"""What every test shares: few threads, one folder for compiled kernels, the example data."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

# Before numba, torch or numpy are imported. Two workers share two cores, and BLAS spins when it waits.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# As `import tg4mm` does, but a test may import torch before it. Numba's threads share libgomp with torch.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
ROOT = Path(__file__).resolve().parent.parent
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".numba_cache"))

import pytest  # noqa: E402

if _offset := int(os.environ.get("TG4MM_SEED_OFFSET", "0")):
    from tests.helpers.seeds import shift_seeds

    shift_seeds(_offset)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what it puts in the background so, and programs that tests start would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)


_TRAINS = """
import tempfile
from pathlib import Path
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.run.train import train
with tempfile.TemporaryDirectory() as root:
    make_synthetic_dataset(Path(root) / "data", n_views=2, n_timesteps=4, size=32, n_test=0)
    train(Path(root) / "data", Path(root) / "run", settings={"space.iterations": "10", "space.max_gaussians": "100"})
"""


def pytest_sessionstart(session):
    """A short training compiles kernels once, before there are workers, each of which would compile them."""
    starts_workers = session.config.getoption("numprocesses", 0) and not hasattr(
        session.config, "workerinput"
    )
    if starts_workers and importlib.util.find_spec("numba"):
        subprocess.run([sys.executable, "-c", _TRAINS], cwd=ROOT, check=False, capture_output=True)


@pytest.fixture(scope="session")
def repo_root():
    """The repository's folder."""
    return ROOT
