"""Wheel and source distribution, built from the sources and installed into clean environments."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
PYENV = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
RESOLVED = ["3.11", "3.13", "3.14"]  # the oldest, Blender's and the newest

LOOK = """
import sys, tg4mm, tg4mm.cli
assert tg4mm.__file__.startswith(sys.prefix), tg4mm.__file__
splat = tg4mm.read_splat(sys.argv[1])
capture = tg4mm.load_capture(sys.argv[2])
print(len(splat), len(capture), tg4mm.load_images(capture).rgb(0).shape)
"""
MOTION = ["spectrum", "sinusoidal", "pcg", "observations", "linear_fit", "uncertainty", "split_half"]


def run(*command, cwd):
    """Its output; no path of this repository in the environment."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONSAFEPATH")}
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, cwd=cwd, env=environment)
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def environment(folder, python=sys.executable):
    """The folder of programs of a new environment in `folder`, without pip."""
    run(python, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    return folder / "bin"


def install(folder, *arguments):
    """Into the environment of those programs, by this environment's pip: what pip says."""
    pip = (sys.executable, "-m", "pip", "--python", folder / "python")
    return run(*pip, "install", "--no-compile", *arguments, cwd=folder)


def interpreter(version):
    """A Python of that version. Skips the test where there is none."""
    places = [Path(sys.executable)] if sys.version_info[:2] == tuple(map(int, version.split("."))) else []
    places += [*PYENV.glob(f"{version}.*/bin/python"), Path(f"/usr/bin/python{version}")]
    for place in places:
        if place.exists():
            return str(place)
    pytest.skip(f"Python {version} is not there")


@pytest.fixture(scope="module")
def built(repo_root, tmp_path_factory):
    """The source distribution of a clean copy of the repository, and the wheel that is built from it."""
    work = tmp_path_factory.mktemp("build")
    run("git", "clone", "--quiet", "--no-hardlinks", repo_root, work / "copy", cwd=work)
    changed = run("git", "ls-files", "--modified", "--others", "--exclude-standard", cwd=repo_root).split()
    for name in changed:  # what is not committed yet
        if (repo_root / name).is_file():
            (work / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            (work / "copy" / name).write_bytes((repo_root / name).read_bytes())
    folder = environment(work / "env")
    install(folder, "build")
    run(folder / "python", "-m", "build", "--outdir", work / "dist", work / "copy", cwd=work)
    (source,), (wheel,) = (list((work / "dist").glob(p)) for p in ("*.tar.gz", "*.whl"))
    return source, wheel


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A splat file and a dataset."""
    from tests.addon.conftest import some_splat
    from tests.helpers.synthetic import make_synthetic_dataset
    from tg4mm.core.splatfile import write_splat

    folder = tmp_path_factory.mktemp("data")
    write_splat(folder / "a.ply", some_splat())
    make_synthetic_dataset(folder / "tiny", n_timesteps=6, alphas=())
    return folder / "a.ply", folder / "tiny"


def test_both_hold_every_module_and_file_of_the_packages(repo_root, built):
    source, wheel = built
    tracked = run("git", "ls-files", "tg4mm", "dataset_gen", cwd=repo_root).split()
    left_out = ("tg4mm/show/web/player/",)  # its sources; what is built of it lies in dist/
    wanted = {n for n in tracked if not n.startswith(left_out) or n.startswith("tg4mm/show/web/player/dist/")}
    with zipfile.ZipFile(wheel) as archive:
        assert wanted - set(archive.namelist()) == set()
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert (wanted | {"LICENSE", "README.md", "CHANGELOG.md", "pyproject.toml"}) - names == set()
    assert not [name for name in names if name.startswith("tests")]  # they need more than the packages


@pytest.fixture(scope="module", params=PYTHONS)
def installed(request, built, tmp_path_factory):
    """A version of Python, and the programs of an environment of it that has the wheel without any extra."""
    work = tmp_path_factory.mktemp(f"python{request.param}")
    folder = environment(work / "env", interpreter(request.param))
    install(folder, built[1])
    return request.param, folder


def test_the_wheel_alone_reads_and_says_what_it_lacks(installed, data, tmp_path):
    """Files, the command line, and one line for what needs torch or Blender."""
    version, folder = installed
    assert run(folder / "python", "-c", LOOK, *data, cwd=tmp_path).split()[:2] == ["23", "48"]
    assert "tg4mm 0" in run(folder / "tg4mm", "--version", cwd=tmp_path)
    for command, message in (
        (["train", data[1], "--out", "run"], 'pip install "tg4mm[core]"'),
        (["sfm", data[1], "--out", "set"], 'pip install "tg4mm[sfm]"'),
        (["process", data[1], "--out", "all"], 'pip install "tg4mm[core,sfm]"'),
        (["view", data[1]], 'pip install "tg4mm[core,view]"'),
        (["demo"], 'pip install "tg4mm[core,generate]"'),
        (
            ["generate", "mic", "--out", "set"],
            'tg4mm[generate]"' if version in ("3.11", "3.13") else "3.11 (Blender 4.5) and 3.13",
        ),
    ):
        words = [str(w) for w in (folder / "tg4mm", *command)]
        done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("version", RESOLVED)
def test_what_the_core_needs_is_to_be_had(version, built, tmp_path):
    """Resolved, not downloaded: torch for one of them may be gigabytes."""
    folder = environment(tmp_path / "env", interpreter(version))
    found = install(folder, "--dry-run", "--only-binary", "torch", f"{built[1]}[core]").lower()
    for name in ("torch", "numba", "llvmlite", "imageio-ffmpeg", "markupsafe"):
        assert f" {name}-" in found


def test_the_core_trains_in_a_clean_environment(built, data, tmp_path, repo_root):
    """With the torch of this environment's version, where pip can have it without CUDA; nothing else of this one.

    Blender 4.5 holds numpy 1.26 in `make test`. Here is 2, by which some tests of the motion fit run, too.
    """
    torch = pytest.importorskip("torch").__version__
    if "+cpu" not in torch:
        pytest.skip(f"torch {torch} would bring CUDA along")
    folder = environment(tmp_path / "env")
    install(folder, f"torch=={torch}", f"{built[1]}[core]")
    sets = ("--set", "space.iterations=60", "--set", "motion.appearance=false")
    listed = run(folder / "tg4mm", "train", "--list-settings", cwd=tmp_path)
    presets = [line.removeprefix("--preset ") for line in listed.splitlines() if line.startswith("--preset")]
    assert presets == ["modal", "paper", "paper-tuned"]
    run(folder / "tg4mm", "train", data[1], "--out", "run", *sets, cwd=tmp_path)
    run(folder / "tg4mm", "render", "run", "--alpha", "5", "--out", "x5", cwd=tmp_path)
    assert list((tmp_path / "x5").rglob("*.mp4"))
    assert run(folder / "python", "-c", "import numpy; print(numpy.__version__)", cwd=tmp_path) >= "2"
    install(folder, "pytest>=8", "hypothesis>=6.100")
    files = [f"tests/fit/motion/test_{name}.py" for name in MOTION]
    run(folder / "python", "-m", "pytest", "-p", "no:cacheprovider", "-m", "not slow", *files, cwd=repo_root)
