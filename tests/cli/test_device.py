"""--device: refused in one line where it cannot be, the same results where it can."""

import sys

import pytest
import torch

from tests.helpers.synthetic import moving_run
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.fit.device import check_device, full_precision


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("device")
    return moving_run(root, n_views=3, n_timesteps=4, size=32, freqs=(5.0,), alphas=(5,), n_test=2)


def test_an_unknown_device_is_named():
    with pytest.raises(Tg4mmError, match=r"\Adevice is 'tpu', expected cpu or cuda\Z"):
        check_device("tpu")


def commands(run, out):
    return [
        ["train", str(run.dataset), "--out", str(out)],
        ["render", str(run.path), "--alpha", "5", "--out", str(out)],
        ["evaluate", str(run.path), "--out", str(out / "m.json")],
    ]


@pytest.mark.parametrize(
    ("has_gpu", "said"),
    [
        (False, "device is cuda, but torch finds no CUDA device here"),
        (True, 'device cuda needs gsplat: pip install "tg4mm[cuda]"'),
    ],
)
@pytest.mark.parametrize("index", range(3))
def test_cuda_without_a_gpu_or_gsplat_is_one_line_and_2(
    index, has_gpu, said, run, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: has_gpu)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    out = tmp_path / "out"
    assert main([*commands(run, out)[index], "--device", "cuda"]) == 2
    assert capsys.readouterr().err == f"tg4mm: {said}\n"
    assert not out.exists()


def test_full_precision_ends_with_its_block(monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    with full_precision("cuda"):
        assert not torch.backends.cudnn.allow_tf32
    assert torch.backends.cudnn.allow_tf32
    with pytest.raises(KeyError), full_precision("cuda"):
        raise KeyError
    assert torch.backends.cudnn.allow_tf32
    with full_precision("cpu"):
        assert torch.backends.cudnn.allow_tf32
