"""The whole benchmark as commands: one after the other, by Snakemake, and what a failure leaves out."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import tg4mm.bench
from tests.helpers.snakemake_program import FARM, snakemake
from tg4mm.bench import presets
from tg4mm.bench.presets import PRESETS, Step, run_preset, steps_of
from tg4mm.cli import main

ROOT = Path(__file__).parents[2]
SNAKEFILE = Path(tg4mm.bench.__file__).parent / "Snakefile"


@pytest.mark.parametrize("name", PRESETS)
def test_steps_need_only_what_comes_before_them(name: str) -> None:
    known: set[str] = set()
    for step in steps_of(name, "out", external=["theirs=dir"]):
        assert set(step.needs) <= known, step.name
        known.add(step.name)
    jobs = [n for n in known if n.startswith("job/")]
    assert len(jobs) == len(PRESETS[name].scenes) * (len(PRESETS[name].methods) + 1)
    assert "page" in known


def test_a_dry_run_prints_commands_that_the_program_accepts(capsys) -> None:
    assert main(["bench", "--preset", "small", "--out", "out", "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(steps_of("small", "out"))
    assert not Path("out").exists()
    assert all(" -m tg4mm " in line for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "large", "--out", "x"], "'large', expected smoke, small, paper"),
        (["--preset", "smoke"], "--out are needed"),
        (["--preset", "smoke", "--out", "x", "--external", "theirs"], "expected NAME=DIR"),
    ],
)
def test_what_is_refused(arguments: list[str], message: str, capsys) -> None:
    assert main(["bench", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_what_fails_is_said_and_the_rest_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def step(name: str, code: str, *needs: str) -> Step:
        return Step(name, (sys.executable, "-c", code), needs)

    mark = tmp_path / "mark"
    steps = [
        step("data/a", "raise SystemExit(1)"),
        step("job/a/m", "raise SystemExit('not run')", "data/a"),
        step("data/b", "pass"),
        step("page", f"open({str(mark)!r}, 'w')", "job/a/m", "data/b"),
    ]
    monkeypatch.setattr(presets, "steps_of", lambda *_, **__: steps)
    said: list[str] = []
    assert run_preset("small", tmp_path, say=said.append) == 2
    assert mark.exists()
    assert any("job/a/m: left out, since data/a failed" in line for line in said)


def run_snakemake(folder: Path, config: dict[str, object], *more: str) -> subprocess.CompletedProcess[str]:
    (folder / "config.json").write_text(json.dumps(config))
    command = [snakemake(), "-s", str(SNAKEFILE), "--configfile", "config.json", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240)


@pytest.mark.parametrize("profile", ["", "local", "slurm"])
def test_a_dry_run_of_the_workflow_names_every_step(tmp_path: Path, profile: str) -> None:
    options = ["--profile", str(FARM / "profiles" / profile)] if profile else ["--cores", "2"]
    config = {"preset": "small", "out": "bench", "python": sys.executable}
    done = run_snakemake(tmp_path, config, "--dry-run", *options)
    said = done.stdout + done.stderr
    if "invalid choice" in said or "not installed" in said:
        pytest.skip(f"the plugins of profiles/{profile} are not installed")
    assert done.returncode == 0, said
    for step in steps_of("small", "bench"):
        assert f"bench/.done/{step.name}" in said
    assert not (tmp_path / "bench").exists()


def test_what_is_wrong_with_a_configuration_is_said(tmp_path: Path) -> None:
    done = run_snakemake(
        tmp_path, {"preset": "large", "out": "x", "python": sys.executable}, "--dry-run", "--cores", "1"
    )
    assert done.returncode == 1
    assert "'large', expected smoke" in done.stdout + done.stderr


@pytest.mark.slow
def test_smoke(tmp_path: Path) -> None:
    """The benchmark whole, from rendering to the page."""
    pytest.importorskip("bpy")
    command = [sys.executable, "-m", "tg4mm", "bench", "--preset", "smoke", "--out", str(tmp_path / "out")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(command, env=environment, check=True, timeout=3000)
    results = json.loads((tmp_path / "out" / "bench" / "results.json").read_text(encoding="utf-8"))
    assert results["failed"] == []
    rows = {line["row"]: line["alphas"]["20"] for line in results["lines"]}
    assert {"nothing moves", "modal", "ceiling", "tracking", "phase-2d", "linear-2d"} <= set(rows)
    # few and noisy pictures, little training: a part of the motion that can be shown, which nothing else gets by chance
    assert rows["modal"]["gain"] > 0.2 * rows["ceiling"]["gain"] > 0.1
    assert rows["modal"]["closure"] > 0.2
    assert (tmp_path / "out" / "bench" / "results.html").stat().st_size > 100_000
