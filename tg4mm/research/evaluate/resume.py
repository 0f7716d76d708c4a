"""What a killed evaluation has finished, so that the next one goes on there."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.files import json_digest, write_json
from tg4mm.core.untrusted import read_json
from tg4mm.research.evaluate.lpips import Lpips
from tg4mm.research.evaluate.scores import Method, Scorer, camera_key, content_key

_VERSION = 2  # of how scores are made: raise it when the same input would score otherwise


class Resume:
    """Finished α, by fingerprint, in a hidden file beside the result, each with a digest of its figures."""

    def __init__(self, target: Path) -> None:
        self._file = target.with_name(f".{target.name}.partial.tmp")

    def get(self, key: str) -> dict[str, Any] | None:
        """The figures; None where there are none, or they are not what was put there."""
        kept = self._read().get(key)
        if not isinstance(kept, dict) or kept.get("digest") != _entry_digest(key, kept.get("entry")):
            return None
        return kept["entry"]

    def put(self, key: str, entry: dict[str, Any]) -> None:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        write_json(self._file, self._read() | {key: {"entry": entry, "digest": _entry_digest(key, entry)}})

    def drop(self) -> None:
        self._file.unlink(missing_ok=True)

    def _read(self) -> dict[str, Any]:
        try:
            kept = read_json(self._file, finite=True)
        except (OSError, ValueError):  # absent, or not ours: nothing to go on from
            return {}
        return kept if isinstance(kept, dict) else {}


def _entry_digest(key: str, entry: Any) -> str:
    return json_digest([key, entry])


def fingerprint(
    scorer: Scorer, methods: list[Method], capture: Capture, images: ImageStack, alpha: float
) -> str:
    """Digest of everything an α's scores depend on, so that only what is still true is resumed."""
    digest = hashlib.blake2b(digest_size=16)
    named = [(m.name, m.band, *([m.posing.label] if m.posing else [])) for m in methods]
    settings = [_VERSION, alpha, sorted(scorer.metrics), named]
    digest.update(json.dumps(settings).encode())
    for tensor in _tensors(scorer):
        digest.update(np.ascontiguousarray(tensor.cpu().numpy()).tobytes())
    for motion in (m.motion for m in methods if m.motion is not None):
        arrays = (motion.freqs_hz, motion.displacement, motion.rotation, motion.gains, motion.magnified)
        light = (
            (None, None)
            if motion.appearance is None
            else (motion.appearance.shapes, motion.appearance.series)
        )
        for array in (*arrays, *light):
            digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    for i, t in enumerate(capture.timesteps.tolist()):
        digest.update(camera_key(capture, i) + content_key(images, i) + t.to_bytes(8, "little"))
    return digest.hexdigest()


def _tensors(scorer: Scorer) -> list[Any]:
    found = [getattr(scorer.gaussians, f.name) for f in fields(scorer.gaussians)]
    lpips = scorer.metrics.get("lpips")
    return found + ([*lpips.weights, *lpips.biases, *lpips.heads] if isinstance(lpips, Lpips) else [])
