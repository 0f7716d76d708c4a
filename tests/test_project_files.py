"""The files around the code: versions agree, and what GitHub reads is what it expects."""

import ast
import io
import re
import runpy
import shutil
import subprocess
import sys
import tokenize
import tomllib

import pytest
import yaml

from tg4mm import __version__

SCHEMAS = {
    ".github/workflows/*.yml": "vendor.github-workflows",
    ".github/ISSUE_TEMPLATE/[!c]*.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/capture.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/config.yml": "vendor.github-issue-config",
    "CITATION.cff": "vendor.citation-file-format",
}
ELSEWHERE = {"vqa.py", "test_video.py"}  # of another program


@pytest.fixture(scope="module")
def project(repo_root):
    return tomllib.loads((repo_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_is_of_this_version(repo_root, project):
    citation = yaml.safe_load((repo_root / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == project["version"] == __version__
    assert citation["license"] == project["license"]


def checked(schema, *files):
    pytest.importorskip("check_jsonschema", reason="needs the extra dev")
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize(("pattern", "schema"), SCHEMAS.items())
def test_files_are_of_their_schema(repo_root, pattern, schema):
    files = sorted(repo_root.glob(pattern))
    assert files
    done = checked(schema, *files)
    assert done.returncode == 0, done.stdout


def test_a_release_gives_the_readme_whole_addresses(repo_root, tmp_path):
    """On the package index a relative link leads nowhere, and a relative picture is not shown."""
    for name in ("README.md", "pyproject.toml"):
        shutil.copyfile(repo_root / name, tmp_path / name)
    script, home = repo_root / ".github" / "whole_links.py", "https://github.com/someone/tg4mm"
    runpy.run_path(str(script))["main"](home, "v0.1.0", str(tmp_path))
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert f"{home}/raw/v0.1.0/docs/images/mic_512.webp" in links
    assert f"{home}/blob/v0.1.0/LICENSE" in links
    assert all(link.startswith("https://") for link in links)
    for link in links:
        if link.startswith(home):
            assert (repo_root / link.split("/v0.1.0/")[1]).exists()
    urls = tomllib.loads((tmp_path / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    assert urls["Repository"] == home
    assert len(urls) == 4


def docstrings(source):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]


def named_files(source):
    """Python files that comments and docstrings of a module name."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    texts = [token.string for token in tokens if token.type == tokenize.COMMENT] + docstrings(source)
    return {name for text in texts for name in re.findall(r"(?<![\w./-])((?:[\w-]+/)*[\w-]+\.py)\b", text)}


def test_comments_name_files_that_exist(repo_root):
    places = ("tg4mm", "dataset_gen", "addon", "benchmarks", "tests", "docs")
    files = [file for place in places for file in (repo_root / place).rglob("*.py")]
    there = [f"/{file.relative_to(repo_root).as_posix()}" for file in files]
    texts = {str(file): text for file in files if ".py" in (text := file.read_text("utf-8"))}
    named = {(file, name) for file, text in texts.items() for name in named_files(text) - ELSEWHERE}
    assert [one for one in named if not any(path.endswith(f"/{one[1]}") for path in there)] == []
    assert named_files('"""See gone.py."""\nx = 1  # as in a/b.py') == {"gone.py", "a/b.py"}


def test_docstrings_are_statements(repo_root):
    files = [
        f for p in ("tg4mm", "dataset_gen", "addon", "benchmarks") for f in (repo_root / p).rglob("*.py")
    ]
    firsts = {(text.split() or [""])[0] for file in files for text in docstrings(file.read_text("utf-8"))}
    assert firsts & {"What", "Whether", "Where", "How", "Which", "Of", "None", "["} == set()
