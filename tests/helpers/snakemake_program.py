"""Where Snakemake lies; without it a test is skipped, or with TG4MM_REQUIRE_SNAKEMAKE=1 fails."""

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

import pytest

import dataset_gen.farm

FARM = Path(dataset_gen.farm.__file__).parent


def snakemake() -> str:
    beside = shutil.which("snakemake", path=str(Path(sys.executable).parent))
    found = os.environ.get("TG4MM_SNAKEMAKE") or beside or shutil.which("snakemake")
    if not found:
        lacking("snakemake is not installed: make farm, and set TG4MM_SNAKEMAKE to .venv-farm/bin/snakemake")
    return found


def lacking(why: str) -> NoReturn:
    if os.environ.get("TG4MM_REQUIRE_SNAKEMAKE", "0") not in {"", "0"}:
        pytest.fail(why)
    pytest.skip(why)


def check_plugins(said: str, profile: str) -> None:
    """Check by a dry run's output that a profile's plugins are there."""
    if any(words in said for words in ("invalid choice", "not installed", "unrecognized arguments")):
        lacking(f"the plugins of profiles/{profile} are not installed: make farm")
