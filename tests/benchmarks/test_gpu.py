"""benchmarks/gpu.py: one line without a GPU, and the whole of it, small, on the CPU."""

import json

import torch

from benchmarks.__main__ import main
from tests.helpers.cuda import needs_cuda


def test_without_a_gpu_it_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    out = tmp_path / "gpu.json"
    assert main(["gpu", "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert said.err.startswith("benchmarks gpu: device is cuda, but torch finds no CUDA device here")
    assert said.out == ""
    assert not out.exists()


def check_smoke(device, tmp_path, capsys):
    out = tmp_path / "gpu.json"
    assert main(["gpu", "--smoke", "--device", device, "--out", str(out)]) == 0
    table = capsys.readouterr().out
    for said in ("5 min 12 s", "2 min 12 s", "all timesteps together", "these figures measure nothing"):
        assert said in table
    result = json.loads(out.read_text())
    assert result["smoke"] is True
    assert result["machine"]["device"] == device
    assert result["space"]["iterations"] == 30
    assert result["motion"]["views"] == 6
    stages = {stage: figures["iterations"] for stage, figures in result["paper"].items()}
    assert stages == {"space": 20, "triplane": 10, "motion": 10}
    assert 0 < result["motion"]["relative_error"] < 0.9  # it did find the sway, which nothing else knows of
    assert set(result["fps"]) == {"64x64", "96x54"}
    assert all(f["on_device"] > 0 and f["fetched"] > 0 for f in result["fps"].values())


def test_smoke_runs_all_of_it_on_the_cpu(tmp_path, capsys):
    check_smoke("cpu", tmp_path, capsys)


@needs_cuda
def test_smoke_runs_all_of_it_on_cuda(tmp_path, capsys):
    check_smoke("cuda", tmp_path, capsys)
