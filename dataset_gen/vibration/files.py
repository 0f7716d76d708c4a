"""YAML and JSON text to plain data. What is wrong with the text is one line with the file's name."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from ..errors import GenerateError
from .values import shown

_LARGEST = 1 << 20  # bytes: a description is a page


def load(path: Path) -> Any:
    """The data in a YAML or JSON file (by its suffix, .json). Raises GenerateError."""
    try:
        size = path.stat().st_size
        if size > _LARGEST:
            raise GenerateError(f"{path} has {size} bytes: a motion description has less than {_LARGEST}")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise GenerateError(f"{path} is not UTF-8 text: {error.reason} at byte {error.start}") from None
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from None
    try:
        return _json(text) if path.suffix.lower() == ".json" else _yaml(text, path)
    except (ValueError, RecursionError) as error:
        if isinstance(error, GenerateError):
            raise
        raise GenerateError(f"{path}: {' '.join(str(error).split())}") from None


def _json(text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise ValueError(f"line {error.lineno} is not JSON: {error.msg}") from None


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """A mapping without repeated keys: the second would silently win."""
    found: dict[Any, Any] = {}
    for key, value in pairs:
        if not isinstance(key, str):
            raise ValueError(f"key {shown(key)} is not text")
        if key in found:
            raise ValueError(f"key {shown(key)} is there twice")
        found[key] = value
    return found


def _yaml(text: str, path: Path) -> Any:
    try:
        import yaml
    except ImportError:
        raise GenerateError(
            f"{path} needs PyYAML, which this Python lacks: '{sys.executable}' -m pip install PyYAML, "
            "or write the same as .json"
        ) from None

    class Loader(yaml.SafeLoader):  # type: ignore[misc, unused-ignore]
        """Plain data only, without repeated keys."""

    def mapping(loader: Any, node: Any) -> dict[Any, Any]:
        # At once, not in SafeLoader's two steps for documents that refer to themselves: of no use here.
        pairs = [(loader.construct_object(k, True), loader.construct_object(v, True)) for k, v in node.value]
        return _unique(pairs)

    Loader.add_constructor("tag:yaml.org,2002:map", mapping)
    try:
        return yaml.load(text, Loader)
    except yaml.YAMLError as error:
        raise ValueError(_yaml_fault(error)) from None


def _yaml_fault(error: Any) -> str:
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or str(error)
    return f"{f'line {mark.line + 1} ' if mark else ''}is not YAML: {problem}"
