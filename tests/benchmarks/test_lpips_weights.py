"""The weights of a package become torch's names and shapes; a pickle of anything but arrays is refused."""

import io
import pickle
import tarfile
from collections import OrderedDict

import numpy as np
import pytest

from benchmarks.__main__ import main
from tg4mm.research.evaluate.lpips import load_lpips

SHAPES = ((11, 11, 3, 64), (5, 5, 64, 192), (3, 3, 192, 384), (3, 3, 384, 256), (3, 3, 256, 256))


def tree():
    rng = np.random.default_rng(0)
    found = {"AlexNet_0": {}}
    for k, shape in enumerate(SHAPES):
        kernel, bias = (rng.normal(size=s).astype(np.float32) for s in (shape, shape[-1:]))
        found["AlexNet_0"][f"Conv_{k}"] = {"kernel": kernel, "bias": bias}
        found[f"NetLinLayer_{k}"] = {"Conv_0": {"kernel": np.ones((1, 1, shape[-1], 1), np.float32)}}
    return found


def package(path, content):
    data = pickle.dumps(content, protocol=4).replace(b"numpy._core", b"numpy.core")
    with tarfile.open(path, "w:gz") as tar:
        entry = tarfile.TarInfo("p-1/src/weights/alexnet.ckpt")
        entry.size = len(data)
        tar.addfile(entry, io.BytesIO(data))
    return path


def test_kernels_are_turned_and_named(tmp_path):
    given, out = tree(), tmp_path / "alex.safetensors"
    assert main(["lpips_weights", str(package(tmp_path / "p.tar.gz", given)), str(out)]) == 0
    weights = load_lpips(out)
    kernel = given["AlexNet_0"]["Conv_1"]["kernel"]
    np.testing.assert_array_equal(weights.weights[1].numpy(), kernel.transpose(3, 2, 0, 1))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (OrderedDict(), "names collections.OrderedDict, which is no array"),
        ({"AlexNet_0": {}}, "holds other arrays than expected"),
    ],
)
def test_what_is_refused(content, message, tmp_path, capsys):
    path, out = package(tmp_path / "p.tar.gz", content), tmp_path / "alex.safetensors"
    assert main(["lpips_weights", str(path), str(out)]) == 2
    assert message in (err := capsys.readouterr().err)
    assert err.count("\n") == 1
    assert not out.exists()
