"""The benchmark: presets against ground truth on many datasets, and the paper's ablations, as tables and pictures."""

from __future__ import annotations
