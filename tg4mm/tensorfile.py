"""Named tensors with a JSON header in one safetensors file, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from tg4mm.errors import RunError
from tg4mm.files import write_atomic

FORMAT = "tg4mm"


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
    # Not save_file: killed, it leaves a temporary file under a name that does not tell whose it was.
    data = save(_apart(stored), metadata=meta)
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def _apart(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors on the CPU, contiguous, no two in one storage (which safetensors refuses)."""
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
    """(tensors, header) of a file that `write_tensors` made. Raises RunError if it is torn, foreign, or of
    another kind or version."""
    try:
        with safe_open(path, framework="pt") as file:
            meta = file.metadata() or {}
            header = _parse(path, meta, kind, version)
            stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise RunError(f"{path} is truncated or not a safetensors file: {_one_line(error)}") from None
    return _join_complex(path, stored), header


def _parse(path: Path, meta: Mapping[str, str], kind: str, version: int) -> dict[str, Any]:
    if meta.get("format") != FORMAT:
        raise RunError(f"{path} was not written by tg4mm: format {meta.get('format')!r}")
    try:
        header = {k: json.loads(v) for k, v in meta.items() if k != "format"}
    except json.JSONDecodeError as error:
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
        if parts[0] is None or parts[1] is None or parts[0].shape != parts[1].shape:
            raise RunError(f"{path}: the real and imaginary part of {name} do not match")
        tensors[name] = torch.complex(parts[0], parts[1])
    return tensors


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
