"""PSNR, SSIM, FLIP and LPIPS against hand computation and the reference formulas."""

import os
import pickle

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from safetensors.torch import save_file
from scipy.ndimage import correlate

from tg4mm.core.metrics import flip, psnr, ssim
from tg4mm.research.evaluate import EvaluationError
from tg4mm.research.evaluate.lpips import load_lpips

LAYERS = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}


@pytest.fixture
def pair():
    rng = np.random.default_rng(0)
    truth = rng.random((40, 33, 3)).astype(np.float32)
    return np.clip(truth + 0.1 * rng.standard_normal(truth.shape), 0, 1).astype(np.float32), truth


def plain_ssim(a, b):
    """Wang et al.'s formula with an explicit 11×11 window, one channel at a time, window inside the image."""
    offsets = np.arange(-5, 6)
    line = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(line, line) / line.sum() ** 2

    def mean(x):
        return correlate(x, window)[5:-5, 5:-5]

    values = []
    for x, y in zip(np.moveaxis(a, -1, 0).astype(float), np.moveaxis(b, -1, 0).astype(float), strict=True):
        mx, my = mean(x), mean(y)
        vx, vy, cov = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
        light, contrast = (2 * mx * my + 1e-4) / (mx**2 + my**2 + 1e-4), (2 * cov + 9e-4) / (vx + vy + 9e-4)
        values.append((light * contrast).mean())
    return float(np.mean(values))


def test_psnr_of_a_known_error():
    truth = np.full((8, 8, 3), 0.5)
    image = truth.copy()
    image[:4] += 0.1  # half of the pixels: mse 0.005
    assert psnr(image, truth) == pytest.approx(10 * np.log10(1 / 0.005))


def test_ssim_is_the_formula_with_an_11_by_11_window(pair):
    assert ssim(*pair) == pytest.approx(plain_ssim(*pair), abs=1e-12)
    assert ssim(pair[1], pair[1]) == pytest.approx(1.0, abs=1e-12)


def test_flip_is_the_evaluators_mean_and_leaves_its_input_alone(pair):
    image, truth = pair
    before = image.copy(), truth.copy()
    flip_evaluator = pytest.importorskip("flip_evaluator")
    errors, mean, _ = flip_evaluator.evaluate(truth, image, "LDR", applyMagma=False)
    assert flip(image, truth) == pytest.approx(mean)
    assert flip(image, truth) == pytest.approx(float(errors.mean()), rel=1e-5)
    assert 0.01 < mean < 1
    assert flip(truth, truth) == 0.0
    for now, then in zip((image, truth), before, strict=True):
        np.testing.assert_array_equal(now, then)


def made_up_weights(trunk="features.{}"):
    """Weights of the right shapes and a sensible size; random, hence no LPIPS, only its arithmetic."""
    g = torch.Generator().manual_seed(0)
    state = {}
    for k, (i, (out, inputs, size)) in enumerate(LAYERS.items()):
        name = trunk.format(i)
        spread = (2 / (inputs * size**2)) ** 0.5
        state[f"{name}.weight"] = spread * torch.randn(out, inputs, size, size, generator=g)
        state[f"{name}.bias"] = torch.randn(out, generator=g) * 0.1
        state[f"lin{k}.model.1.weight"] = torch.rand(1, out, 1, 1, generator=g)
    return state


def conv(x, weight, bias, stride, padding):
    """Plain convolution of x [C, H, W]: windows times weights."""
    x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    windows = sliding_window_view(x, weight.shape[2:], axis=(1, 2))[:, ::stride, ::stride]
    return np.einsum("chwij,ocij->ohw", windows, weight, optimize=True) + bias[:, None, None]


def plain_lpips(a, b, state):
    """LPIPS v0.1 as Zhang et al. describe it, float64 numpy."""
    w = {k: v.double().numpy() for k, v in state.items()}
    shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    maps = [np.moveaxis((2 * x.astype(float) - 1 - shift) / scale, -1, 0) for x in (a, b)]
    total = 0.0
    for k, i in enumerate(LAYERS):
        if i in {3, 6}:
            maps = [sliding_window_view(m, (3, 3), axis=(1, 2))[:, ::2, ::2].max((3, 4)) for m in maps]
        stride, padding = {0: (4, 2), 3: (1, 2)}.get(i, (1, 1))
        layer = w[f"features.{i}.weight"], w[f"features.{i}.bias"], stride, padding
        maps = [np.maximum(conv(m, *layer), 0) for m in maps]
        unit = [m / np.sqrt((m**2).sum(0)) for m in maps]
        total += (w[f"lin{k}.model.1.weight"][0] * (unit[0] - unit[1]) ** 2).sum(0).mean()
    return total


@pytest.fixture(scope="module")
def images():
    rng = np.random.default_rng(1)
    truth = rng.random((47, 64, 3)).astype(np.float32)
    return np.clip(truth + 0.2 * rng.standard_normal(truth.shape), 0, 1).astype(np.float32), truth


def test_equals_a_plain_computation(images, tmp_path):
    state = made_up_weights()
    save_file(state, tmp_path / "both.safetensors")
    metric = load_lpips(tmp_path / "both.safetensors")
    expected = plain_lpips(*images, state)
    assert expected > 0.01
    assert metric(*images) == pytest.approx(expected, rel=1e-4)
    assert metric(images[0], images[0]) == 0.0
    assert metric(*images) == pytest.approx(metric(*images[::-1]), rel=1e-6)


def test_files_of_every_kind_give_the_same_metric(images, tmp_path):
    state = made_up_weights()
    trunk = {k: v for k, v in state.items() if k.startswith("features")}
    heads = {k: v for k, v in state.items() if k.startswith("lin")}
    save_file(state, tmp_path / "both.safetensors")
    apart = tmp_path / "apart"
    apart.mkdir()
    # torchvision's file also has the classifier; the lpips package's own names its convolutions by slice.
    torch.save(trunk | {"classifier.1.weight": torch.zeros(2, 2)}, apart / "alexnet.pth")
    torch.save(heads, apart / "alex.pth")
    slices = {"0": "1", "3": "2", "6": "3", "8": "4", "10": "5"}
    renamed = {f"net.slice{slices[k.split('.')[1]]}.{k.split('.', 1)[1]}": v for k, v in trunk.items()}
    torch.save(renamed | heads, tmp_path / "package.pth")
    expected = load_lpips(tmp_path / "both.safetensors")(*images)
    assert load_lpips(apart)(*images) == expected
    assert load_lpips([apart / "alexnet.pth", str(apart / "alex.pth")])(*images) == expected
    assert load_lpips(tmp_path / "package.pth")(*images) == expected


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({f"lin{k}.model.1.weight": None for k in range(5)}, r"lin0\.model\.1\.weight is not in"),
        ({"features.6.bias": None}, r"features\.6\.bias is not in"),
        (
            {"features.3.weight": torch.zeros(64, 64, 3, 3)},
            r"weight 3 .* \(64, 64, 3, 3\), expected \(192, 64, 5, 5\)",
        ),
        ({"features.0.bias": torch.full((64,), np.nan)}, "not finite"),
    ],
)
def test_weights_that_are_none_of_this_network_are_named(tmp_path, change, message):
    state = {k: v for k, v in (made_up_weights() | change).items() if v is not None}
    save_file(state, tmp_path / "w.safetensors")
    with pytest.raises(EvaluationError, match=message):
        load_lpips(tmp_path / "w.safetensors")


class Payload:
    def __reduce__(self):
        return os.mkdir, ("payload_ran",)


@pytest.mark.parametrize("protocol", [None, 4])
def test_a_pickle_with_code_is_refused_in_one_line_and_does_not_run(tmp_path, monkeypatch, recwarn, protocol):
    monkeypatch.chdir(tmp_path)
    if protocol is None:
        torch.save({"features.0.weight": Payload()}, tmp_path / "evil.pth")
    else:
        (tmp_path / "evil.pth").write_bytes(pickle.dumps({"features.0.weight": Payload()}, protocol))
    with pytest.raises(EvaluationError, match=r"evil\.pth cannot be read: Weights only load failed$"):
        load_lpips(tmp_path / "evil.pth")
    assert not recwarn.list
    assert not (tmp_path / "payload_ran").exists()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("nowhere.pth", None, r"nowhere\.pth does not exist"),
        ("", None, r"holds no \.safetensors"),
        ("weights.bin", b"x", r"suffix '\.bin'"),
        ("list.pth", [1, 2], "holds list"),
        ("torn.pth", 20_000, "cannot be read"),
        ("torn.safetensors", 20_000, "cannot be read"),
    ],
)
def test_what_is_no_weight_file_is_one_line(tmp_path, name, content, message):
    path = tmp_path / name
    if content == 20_000:  # the first bytes of a whole one
        torch.save(made_up_weights(), path) if name.endswith("pth") else save_file(made_up_weights(), path)
        content = path.read_bytes()[:content]
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        torch.save(content, path)
    with pytest.raises(EvaluationError, match=message) as caught:
        load_lpips(path)
    assert "\n" not in str(caught.value)
