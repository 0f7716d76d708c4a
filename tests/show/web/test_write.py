"""The page as a file: whole, alone, and refused where it could not be."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.run import Run
from tg4mm.show.web.write import Page, export_html, make_page, render


def scene_of(text: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="scene">(.*?)</script>', text).group(1))


def test_the_command_writes_the_page_and_prints_its_name(moving_run, tmp_path, capsys):
    target = tmp_path / "deep" / "mic.html"
    assert main(["export", str(moving_run.path), "--format", "html", "--out", str(target)]) == 0
    assert capsys.readouterr().out == f"{target}\n"
    text = target.read_text(encoding="utf-8")
    scene = scene_of(text)
    assert scene["layout"]["n_gaussians"] == len(moving_run.load_space())
    assert scene["motion"]["freqs_hz"] == [3.0, 6.0]
    assert sorted(scene["motion"]["peaks_hz"]) == [3.0, 6.0]
    assert scene["camera"]["width"] == 96
    assert [path.name for path in target.parent.iterdir()] == ["mic.html"]


def test_the_page_lets_only_its_own_program_run(page_file):
    text = page_file.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    program = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(program) == 1
    digest = base64.b64encode(hashlib.sha256(program[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}' 'wasm-unsafe-eval';" in policy
    assert "http" not in policy
    assert "default-src 'none'" in policy


def test_words_of_the_dataset_cannot_become_markup(moving_run):
    page = make_page(moving_run)
    bad = "</script><script>alert(1)</script><b>"
    text = render(replace(page, scene={**page.scene, "title": bad}))
    assert scene_of(text)["title"] == bad
    assert "<b>" not in text.replace(text[text.index("<script>") :], "")
    assert text.count("<script") == render(page).count("<script")


def test_a_run_without_motion_is_a_page_of_the_still_scene(still_run, tmp_path):
    scene = scene_of(export_html(still_run, tmp_path / "still.htm").read_text(encoding="utf-8"))
    assert scene["motion"] is None
    assert scene["layout"]["n_fields"] == 0


def test_an_offset_of_0_hz_is_not_magnified(moving_run, tmp_path):
    run = Run.create(tmp_path / "run", moving_run.dataset, "modal", {})
    motion = moving_run.load_motion()
    run.save_space(moving_run.load_space(), {})
    run.save_motion(replace(motion, freqs_hz=np.array([0.0, 6.0])), {})
    assert make_page(run).scene["motion"]["magnified"] == [False, True]


def test_the_page_opens_with_a_camera_that_stays_put(tmp_path):
    """A picture of a sweep, from close by, would show more motion, but nothing was recorded from there."""
    gaussians, motion = make_synthetic_dataset(tmp_path / "data", n_views=3, n_timesteps=6, size=16, n_test=0)
    for t in range(1, 6):
        file = tmp_path / "data" / f"{t:03d}" / "transforms_train.json"
        values = json.loads(file.read_text())
        file.write_text(json.dumps(values | {"frames": values["frames"][:1]}))
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", {})
    run.save_space(gaussians, {})
    run.save_motion(motion, {})
    assert make_page(run).scene["camera"]["name"] == "r_000"


def test_bad_outs_are_refused_and_nothing_is_written(moving_run, tmp_path):
    with pytest.raises(Tg4mmError, match=r"is a folder; expected a file such as .*scene\.html"):
        export_html(moving_run, tmp_path)
    with pytest.raises(Tg4mmError, match=r"a\.ply: expected a name that ends in \.html"):
        export_html(moving_run, tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())


def test_options_of_other_formats_are_refused(moving_run, tmp_path, capsys):
    command = [
        "export",
        str(moving_run.path),
        "--format",
        "html",
        "--out",
        str(tmp_path / "a.html"),
        "--alpha",
        "3",
    ]
    assert main(command) == 2
    assert "a page holds the motion itself" in capsys.readouterr().err


def test_a_run_whose_dataset_is_gone_is_refused(moving_run, tmp_path):
    run = Run.create(tmp_path / "run", tmp_path / "gone", "modal", {})
    run.save_space(moving_run.load_space(), {})
    with pytest.raises(RunError, match="dataset is gone; a page opens with one of its cameras"):
        export_html(run, tmp_path / "a.html")


# The program: built from what lies beside it, with the licences of what is in it.


def stale(player: Path) -> list[str]:
    """Files that are not those of which the bundle says that it was made, and the bundle if it is another."""
    made = json.loads((player / "dist" / "sources.json").read_text())
    there = {f"src/{path.name}" for path in (player / "src").iterdir()}
    changed = {
        name
        for name, digest in made.items()
        if hashlib.sha256((player / name).read_bytes()).hexdigest() != digest
    }
    return sorted(changed | (there ^ {name for name in made if name.startswith("src/")}))


def test_the_program_is_built_from_its_sources(repo_root):
    found = stale(repo_root / "tg4mm" / "show" / "web" / "player")
    assert not found, (
        f"changed since the last build: {found}; cd tg4mm/show/web/player && npm ci && npm run build"
    )


def test_a_program_older_than_its_sources_is_seen(repo_root, tmp_path):
    player = repo_root / "tg4mm" / "show" / "web" / "player"
    for name in json.loads((player / "dist" / "sources.json").read_text()):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((player / name).read_bytes())
    (tmp_path / "dist" / "sources.json").write_bytes((player / "dist" / "sources.json").read_bytes())
    assert stale(tmp_path) == []
    (tmp_path / "src" / "motion.js").write_text("// changed")
    (tmp_path / "src" / "new.js").write_text("")
    assert stale(tmp_path) == ["src/motion.js", "src/new.js"]


def test_the_page_names_the_licences_of_what_is_in_it(page_file):
    text = page_file.read_text(encoding="utf-8")
    for words in ("@sparkjsdev/spark 2.2.0", "three 0.187.0", "MIT License", "WORLD LABS"):
        assert words in text


def test_a_page_is_its_scene_and_its_numbers(moving_run):
    page = make_page(moving_run)
    assert isinstance(page, Page)
    assert base64.b64encode(page.block).decode() in render(page)
