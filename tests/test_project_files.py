"""The files around the code: versions agree, and what GitHub reads is what it expects."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from tg4mm import __version__


@pytest.fixture(scope="module")
def project(repo_root: Path) -> dict[str, Any]:
    return tomllib.loads((repo_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_is_of_this_version(repo_root: Path, project: dict[str, Any]) -> None:
    citation = yaml.safe_load((repo_root / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == project["version"] == __version__
    assert citation["license"] == project["license"]


def test_torch_has_no_upper_bound_and_a_tested_version(repo_root: Path, project: dict[str, Any]) -> None:
    (torch,) = (one for one in project["optional-dependencies"]["core"] if one.startswith("torch"))
    assert torch == "torch>=2.6"
    lines = (repo_root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert [line.partition("==")[0] for line in lines if not line.startswith("#")] == ["torch"]


SCHEMAS = {
    ".github/workflows/*.yml": "vendor.github-workflows",
    ".github/ISSUE_TEMPLATE/[!c]*.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/capture.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/config.yml": "vendor.github-issue-config",
    "CITATION.cff": "vendor.citation-file-format",
}


def checked(schema: str, *files: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("check_jsonschema", reason="needs the extra dev")
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize(("pattern", "schema"), SCHEMAS.items())
def test_files_are_of_their_schema(repo_root: Path, pattern: str, schema: str) -> None:
    files = sorted(repo_root.glob(pattern))
    assert files
    done = checked(schema, *files)
    assert done.returncode == 0, done.stdout


def test_a_workflow_with_a_fault_is_found(repo_root: Path, tmp_path: Path) -> None:
    text = (repo_root / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    bad = tmp_path / "test.yml"
    bad.write_text(text.replace("runs-on:", "runs_on:"), encoding="utf-8")
    assert checked("vendor.github-workflows", bad).returncode != 0


def test_workflows_name_files_that_are_there(repo_root: Path) -> None:
    """Of the repository: tests, scripts and constraints that a step's commands name."""
    named = []
    for workflow in sorted((repo_root / ".github" / "workflows").glob("*.yml")):
        jobs = yaml.safe_load(workflow.read_text(encoding="utf-8"))["jobs"].values()
        words = [w for job in jobs for step in job["steps"] for w in step.get("run", "").split()]
        named += [w for w in words if w.startswith(("tests/", "addon/", ".ci/")) or w == "constraints.txt"]
    assert len(named) > 10
    assert not [name for name in named if not (repo_root / name).exists()]
