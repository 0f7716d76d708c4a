"""A digest of what a run has learned: equal models have equal digests, wherever and however they were written."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from safetensors import safe_open

from tg4mm.core.errors import RunError
from tg4mm.run.tensor_file import DIGEST

_FILES = ("space", "motion", "triplane")
# The dataset's folder and the settings that led to it, and the digest, which those are in.
_NOT_OF_THE_MODEL = ("config", "format", DIGEST)


def model_hash(run_path: Path) -> str:
    """SHA-256 over the tensors of a run's model files, with their names, types, shapes and headers; of a splat file
    over its bytes.

    Not over the files' bytes: safetensors writes its header in no fixed order. Motion triplanes of `paper` are in it by
    the motion that they decode to. Raises RunError for a file that is torn.
    """
    if run_path.is_file():  # a splat file
        with run_path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    digest = hashlib.sha256()
    for name in _FILES:
        path = run_path / f"{name}.safetensors"
        if path.is_file():
            digest.update(name.encode())
            _update(digest, path)
    return digest.hexdigest()


def _update(digest: hashlib._Hash, path: Path) -> None:
    try:
        with safe_open(path, framework="numpy") as file:
            header = {k: v for k, v in (file.metadata() or {}).items() if k not in _NOT_OF_THE_MODEL}
            digest.update(json.dumps(header, sort_keys=True).encode())
            for name in sorted(file.keys()):
                tensor = np.ascontiguousarray(file.get_tensor(name))
                digest.update(json.dumps([name, tensor.dtype.str, tensor.shape]).encode())
                digest.update(tensor.data)
    except Exception as error:  # the package reports damage by many types
        raise RunError(
            f"{path} is truncated or not a safetensors file: {' '.join(str(error).split())}"
        ) from None
