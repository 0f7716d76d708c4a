"""Named tensors with a JSON header in one safetensors file, written atomically; digests of files and models."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

from tg4mm.core.errors import RunError
from tg4mm.core.files import WINDOWS, write_atomic
from tg4mm.core.untrusted import parse_json

FORMAT = "tg4mm"
DIGEST = "digest"  # header entry, since a flipped bit in a number would silently change results
_FILES = ("space", "motion", "triplane")
# The dataset's folder and the settings that led to it, and the digest, which those are in.
_NOT_OF_THE_MODEL = ("config", "format", DIGEST)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    """Write `tensors` and `header` (JSON values; must hold `kind` and `version`) to `path`, atomically.

    safetensors metadata is text to text: each header entry is stored as its JSON text, `format` as it is.
    A complex tensor becomes `name#re` and `name#im`.
    """
    stored: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        if tensor.is_complex():
            stored[f"{name}#re"], stored[f"{name}#im"] = tensor.real, tensor.imag
        else:
            stored[name] = tensor
    meta = {k: json.dumps(v, allow_nan=False) for k, v in header.items()} | {"format": FORMAT}
    # Not save_file, which leaves an anonymous temporary file if it is killed.
    stored = _apart(stored)
    data = save(stored, metadata=meta | {DIGEST: _digest(stored, meta)})
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def _apart(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors on the CPU, contiguous, no two in one storage (which safetensors refuses)."""
    apart: dict[str, Tensor] = {}
    seen: set[int] = set()
    for name, tensor in tensors.items():
        own = tensor.detach().cpu().contiguous()
        if own.untyped_storage().data_ptr() in seen:
            own = own.clone()
        seen.add(own.untyped_storage().data_ptr())
        apart[name] = own
    return apart


def read_tensors(path: Path, kind: str, version: int) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read (tensors, header) of a file that `write_tensors` made.

    Raises RunError if it is incomplete, foreign, of another kind or version, or not as it was written.
    The header lacks DIGEST where the file is from before digests: whoever cannot do without one refuses that.
    """
    try:
        with safe_open(path, framework="pt") as file:
            meta = file.metadata() or {}
            header = _parse(path, meta, kind, version)
            stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            if WINDOWS:  # they are mapped: the file could not be replaced while one of them lives
                stored = {name: tensor.clone() for name, tensor in stored.items()}
    except RunError:
        raise
    # The package and torch report damage by many types: SafetensorError, RuntimeError, KeyError of a type.
    except Exception as error:
        raise RunError(
            f"{path} is truncated or not a safetensors file: {' '.join(str(error).split())}"
        ) from None
    texts = {k: v for k, v in meta.items() if k != DIGEST}
    if DIGEST in meta and meta[DIGEST] != _digest(stored, texts):
        raise RunError(f"{path} is damaged or edited: its content is not what was written")
    return _join_complex(path, stored), header


def _parse(path: Path, meta: Mapping[str, str], kind: str, version: int) -> dict[str, Any]:
    if meta.get("format") != FORMAT:
        raise RunError(f"{path} was not written by tg4mm: format {meta.get('format')!r}")
    try:
        header = {k: v if k == DIGEST else parse_json(v) for k, v in meta.items() if k != "format"}
    except ValueError as error:
        raise RunError(f"{path} has a header that is not JSON: {error}") from None
    for key, expected in (("kind", kind), ("version", version)):
        if header.get(key) != expected:
            raise RunError(f"{path} has {key} {header.get(key)!r}, expected {expected!r}")
    if not isinstance(header.get("config"), dict):
        raise RunError(f"{path} has config {header.get('config')!r}, expected an object")
    return header


def _join_complex(path: Path, stored: dict[str, Tensor]) -> dict[str, Tensor]:
    tensors = {name: t for name, t in stored.items() if "#" not in name}
    for name in {name.partition("#")[0] for name in stored if "#" in name}:
        parts = stored.get(f"{name}#re"), stored.get(f"{name}#im")
        if parts[0] is None or parts[1] is None or not _match(parts[0], parts[1]):
            raise RunError(f"{path}: the real and imaginary part of {name} do not match")
        tensors[name] = torch.complex(parts[0], parts[1])
    return tensors


def _match(re: Tensor, im: Tensor) -> bool:
    return re.shape == im.shape and re.dtype == im.dtype and re.dtype in (torch.float32, torch.float64)


def _digest(stored: Mapping[str, Tensor], meta: Mapping[str, str]) -> str:
    """Return the SHA-256 of header and tensors (on the CPU, contiguous) with their names, types and shapes."""
    digest = hashlib.sha256(json.dumps(dict(meta), sort_keys=True).encode())
    for name, tensor in sorted(stored.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        if tensor.numel():  # of a run without motion there are none
            digest.update(np.ascontiguousarray(tensor.numpy()).data)
    return digest.hexdigest()


def model_hash(run_path: Path) -> str:
    """Return the SHA-256 of a run's model files: tensors with their names, types, shapes and headers.

    Of a splat file it is the SHA-256 of its bytes.

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


def _update(digest: "hashlib._Hash", path: Path) -> None:
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
