"""The site builds strictly, commands on its pages exist with their options, links lead somewhere."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from cyclopts.exceptions import UnknownCommandError

from docs import links
from tg4mm.cli.program import help_text

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_HISTORY = {"results.md"}  # say what was run then


def commands(text):
    """Lines of code blocks that call tg4mm, without their comments."""
    lines = re.findall(r"^(?: {4}|\$ )(tg4mm (?!generate).+)$", text, re.MULTILINE)
    return [line.split(" # ")[0].strip() for line in lines]


def unknown_options(command, helps):
    """Options of `command` that its --help does not list; its own name where there is no such command."""
    words = shlex.split(command)
    is_part = words[1] == "bench" and not words[2].startswith("--")
    name = " ".join(words[1:3]) if is_part else words[1]
    if name not in helps:
        try:
            helps[name] = help_text(*name.split())
        except UnknownCommandError:
            helps[name] = ""
    if not helps[name]:
        return [name]
    options = [word.split("=")[0] for word in words if word.startswith("--")]
    return [option for option in options if not re.search(rf"(?<![\w-]){option}(?![\w-])", helps[name])]


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in _HISTORY], ids=lambda p: p.name)
def test_commands_on_the_pages_exist(page):
    helps: dict[str, str] = {}
    wrong = {}
    for command in commands(page.read_text(encoding="utf-8")):
        if re.search(r"[A-Z…]{4,}$|…", command.split()[1]):
            continue
        if bad := unknown_options(command, helps):
            wrong[command] = bad
    assert not wrong


def test_an_option_that_is_not_there_is_seen():
    assert unknown_options("tg4mm train data --out run --iterations 5", {}) == ["--iterations"]
    assert unknown_options("tg4mm teach data", {}) == ["teach"]
    assert unknown_options("tg4mm train data --out run --device cuda", {}) == []
    assert unknown_options("tg4mm bench --presets small --out bench", {}) == ["--presets"]
    assert unknown_options("tg4mm bench scenes data --out bench --presets modal", {}) == ["--presets"]


@pytest.mark.parametrize("page", links.PAGES, ids=lambda p: p.name)
def test_links_lead_to_files_and_anchors(page):
    assert not links.broken(page)


def test_a_link_that_leads_nowhere_is_seen(tmp_path):
    (tmp_path / "b.md").write_text("# Some title\n")
    page = tmp_path / "a.md"
    page.write_text(
        "[1](b.md#some-title) [2](c.md) [3](b.md#other) [4](#here) `[5](d.md)` [6](settings.md)\n"
    )
    assert links.broken(page) == ["c.md", "b.md#other", "#here"]


def test_the_documents_stay_short():
    """Words are counted without the rules of tables, which `wc -w` counts too."""
    words = [word for page in links.PAGES for word in page.read_text(encoding="utf-8").split()]
    assert sum(any(map(str.isalnum, word)) for word in words) <= 38_000


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path):
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    settings = (tmp_path / "site/settings.html").read_text(encoding="utf-8")
    assert "space.iterations" in settings
    assert "motion.gauss_newton" in settings
    assert "Raises" in (tmp_path / "site/api.html").read_text(encoding="utf-8")
    assert "--keep" in (tmp_path / "site/commands.html").read_text(encoding="utf-8")
