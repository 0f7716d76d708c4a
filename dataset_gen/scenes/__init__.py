"""The built-in scenes, by name. A builder takes (frequency_hz, amplitude) and returns the description."""

from __future__ import annotations

from collections.abc import Callable

from ..scene import Scene
from . import mic

SCENES: dict[str, Callable[[float, float], Scene]] = {"mic": mic.build}
