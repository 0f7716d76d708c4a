"""YAML and JSON text to plain data. What is wrong with the text is one line with the file's name."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tg4mm.core.untrusted import read_json, read_yaml

from ..errors import GenerateError

_LARGEST = 1 << 20  # bytes of JSON: a description is a page


def load(path: Path) -> Any:
    """The data in a YAML or JSON file (by its suffix, .json). Raises GenerateError."""
    try:
        return read_json(path, _LARGEST) if path.suffix.lower() == ".json" else read_yaml(path)
    except ImportError:
        raise GenerateError(
            f"{path} needs PyYAML, which this Python lacks: '{sys.executable}' -m pip install PyYAML, "
            "or write the same as .json"
        ) from None
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise GenerateError(f"{path}: {' '.join(str(error).split())}") from None
