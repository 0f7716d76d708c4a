"""An unfinished space stage that does not fit is refused in one line and stays on disk, whoever wrote it."""

from dataclasses import replace

import pytest
from safetensors import safe_open
from safetensors.torch import save_file

from tests.helpers.runs import copied
from tests.helpers.space_train import SHORT, Killed, killed_after
from tg4mm.core.errors import RunError
from tg4mm.fit.space import RestViews
from tg4mm.fit.space import train as stage
from tg4mm.run import Run
from tg4mm.run.stages import train_space

FILE = "checkpoint_space.safetensors"


def _killed(root, data, views, points, config):
    """A run killed after 12 of 36 iterations, in the middle of its second round of views."""
    run = Run.create(root / "run", data, "modal", {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "CHECKPOINT_EVERY_S", -1.0)
        patch.setattr(stage, "progress", killed_after(13))
        with pytest.raises(Killed):
            train_space(run, views, points, config)
    return run


@pytest.fixture(scope="module")
def killed_once(data, views, points, tmp_path_factory):
    """Without gains and with them."""
    return {
        gains: _killed(tmp_path_factory.mktemp("killed"), data, views, points, replace(SHORT, gains=gains))
        for gains in (False, True)
    }


@pytest.fixture
def interrupted(killed_once, tmp_path):
    return copied(killed_once[False], tmp_path / "run")


def forge(run, change):
    """Rewrite the checkpoint as someone would who knows the format, its digest as well."""
    checkpoint = run.load_checkpoint("space")
    assert checkpoint is not None
    tensors, state = checkpoint
    change(tensors, state)
    run.save_checkpoint("space", tensors, state)


def put(**values):
    return lambda _, state: state.update(values)


def tensor(name, change):
    return lambda tensors, _: tensors.update({name: change(tensors[name]).contiguous()})


def without(name):
    return lambda tensors, _: tensors.__delitem__(name)


def no_rows(tensors, _):
    for name, value in tensors.items():
        if value.dim() and name != "generator":
            tensors[name] = value[:0].clone()


FORGED = {
    "a negative iteration": (put(iteration=-5), "iteration is -5, which is not valid for 36 iterations on 10 views"),
    "an iteration in words": (put(iteration="7"), 'iteration is "7"'),
    "a view that is not there": (put(order=[10]), r"order is \[10\]"),
    "no psnr": (put(psnr=None), "psnr is null"),
    "a scene of no extent": (put(extent=0.0), "extent is 0.0"),
    "no means": (without("means"), "it holds the tensors .*expected .*'means'"),
    "no moments": (without("adam.means.m"), "expected .*'adam.means.m'"),
    "too short": (tensor("means", lambda t: t[:7]), r"means is torch.float32 \(7, 3\), expected float32 \(\d+, 3\)"),
    "another degree": (tensor("shn", lambda t: t[:, :3]), r"shn is torch.float32 \(\d+, 3, 3\)"),
    "double precision": (tensor("means", lambda t: t.double()), "means is torch.float64"),
    "half a generator": (tensor("generator", lambda t: t[:100]), "generator is no state of a random generator"),
    "no Gaussians": (no_rows, "it holds 0 Gaussians, expected 1 to 500"),
}  # fmt: skip


@pytest.mark.parametrize("what", list(FORGED))
def test_a_forged_checkpoint_is_refused(what, interrupted, views, points):
    """With its digest put right. Shapes above all: the kernels would write past their arrays."""
    change, match = FORGED[what]
    forge(interrupted, change)
    file = interrupted.path / FILE
    before = file.read_bytes()
    with pytest.raises(RunError, match=rf"\A[^\n]*checkpoint_space[^\n]*{match}[^\n]*delete it[^\n]*\Z"):
        train_space(interrupted, views, points, SHORT)
    assert file.read_bytes() == before
    assert not interrupted.has_space


def flipped(place):
    def flip(file):
        raw = bytearray(file.read_bytes())
        raw[int(place * len(raw))] ^= 1
        file.write_bytes(raw)

    return flip


def with_header(**header):
    """The file with entries of its header changed or, None, left out."""

    def rewrite(file):
        with safe_open(file, framework="pt") as opened:
            meta = opened.metadata() | header
            tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
        save_file(tensors, file, metadata={k: v for k, v in meta.items() if v is not None})

    return rewrite


@pytest.mark.parametrize(
    ("damage", "match"),
    [
        *((flipped(p), "damaged or edited: its content is not what was written; delete it") for p in (0.3, 0.6, 0.999)),
        (with_header(digest=None), r"by another version.*; delete it to start the space stage again"),
        (with_header(version="99"), "has version 99, expected 1; delete it"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused(damage, match, interrupted, views, points):
    damage(interrupted.path / FILE)
    with pytest.raises(RunError, match=match):
        train_space(interrupted, views, points, SHORT)


def test_pictures_that_changed_underneath_are_refused(interrupted, views, points):
    """One pixel of one picture; fewer views; one camera moved."""
    rgb = views.rgb.copy()
    rgb[3, 0, 0, 0] -= 1 / 255
    moved = views.viewmats.copy()
    moved[2, 0, 3] += 1e-3
    fewer = {name: getattr(views, name)[:4] for name in ("viewmats", "Ks", "rgb", "alpha", "images")}
    for changed in (replace(views, rgb=rgb), replace(views, viewmats=moved), RestViews(**fewer)):
        with pytest.raises(RunError, match="cameras or pictures of the dataset have changed since"):
            train_space(interrupted, changed, points, SHORT)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (without("gains"), "expected .*'gains'"),
        (tensor("gains", lambda t: t[:3]), r"gains is torch.float32 \(3, 3\), expected float32 \(10, 3\)"),
    ],
)
def test_forged_gains_are_refused(change, match, killed_once, tmp_path, views, points):
    run = copied(killed_once[True], tmp_path / "run")
    forge(run, change)
    with pytest.raises(RunError, match=match):
        train_space(run, views, points, replace(SHORT, gains=True))
