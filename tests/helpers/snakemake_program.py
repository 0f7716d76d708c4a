"""Where Snakemake lies; without it a test is skipped."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

import dataset_gen.farm

FARM = Path(dataset_gen.farm.__file__).parent


def snakemake() -> str:
    beside = shutil.which("snakemake", path=str(Path(sys.executable).parent))
    found = os.environ.get("TG4MM_SNAKEMAKE") or beside or shutil.which("snakemake")
    if not found:
        pytest.skip(
            "snakemake is not installed: pip install snakemake, or set TG4MM_SNAKEMAKE to where it lies"
        )
    return found
