"""A method joins by its pictures: the worked example of docs/protocol.md, and what is refused."""

import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dataset_gen.points import write_ply
from tg4mm.capture.truth_file import load_truth
from tg4mm.cli import main
from tg4mm.research.bench.jobs import run_job
from tg4mm.research.bench.methods.video import Linear2D
from tg4mm.research.bench.pages.tables import groups_of, tables_of
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.scored import checkouts
from tg4mm.research.bench.sets import open_set

ROOT = Path(__file__).parents[3]


def blend(folder):
    """Write each ground truth picture blended with the next: no method, but quick."""
    for picture in (folder / "data").rglob("test/*.png"):
        later = picture.parents[2] / f"{(int(picture.parts[-3]) + 1) % 6:03d}" / "test" / picture.name
        target = folder / "theirs" / picture.relative_to(folder / "data")
        target.parent.mkdir(parents=True, exist_ok=True)
        Image.blend(*(Image.open(path).convert("RGBA") for path in (picture, later)), 0.5).save(target)


def example():
    """(the program, the command) of the page."""
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", page, re.S)
    command = next(x for x in page.splitlines() if x.startswith("    tg4mm bench scenes") and "=theirs" in x)
    return program, command.strip()


@pytest.fixture(scope="module")
def joined(data, tmp_path_factory):
    """A method run by the page's command, in a folder with a dataset, and beside it a broken one."""
    folder = tmp_path_factory.mktemp("join")
    shutil.copytree(data, folder / "data" / "mic_5Hz_0_005")
    (folder / "data" / "broken").mkdir()
    command = example()[1].replace("pyrtools=theirs", "blend=theirs")
    blend(folder)
    _, _, *arguments = shlex.split(command)
    arguments = [*arguments, "data/broken", "--methods", "linear-2d"]
    subprocess.run(
        [sys.executable, "-m", "tg4mm", "bench", *arguments], cwd=folder, timeout=300, check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1", "HOME": str(folder)},
    )  # fmt: skip
    out = folder / arguments[arguments.index("--out") + 1]
    return out, json.loads((out / "results.json").read_text(encoding="utf-8"))


def test_the_program_of_the_page_magnifies(data, tmp_path):
    """Its picture at α = 5 differs from the one at rest as the ground truth's does."""
    pytest.importorskip("pyrtools")
    shutil.copytree(data, tmp_path / "data" / "mic_5Hz_0_005")
    subprocess.run([sys.executable, "-c", example()[0]], cwd=tmp_path, check=True, timeout=120)
    found = []
    for name in ("data", "theirs"):
        paths = sorted((tmp_path / name).rglob("x005/*/test/*.png"))
        rgba = np.stack([np.asarray(Image.open(path).convert("RGBA"), float) for path in paths])
        white = rgba[..., :3] * rgba[..., 3:] + 255 * (255 - rgba[..., 3:])
        found.append((white - white.mean(0)).ravel())
    assert np.corrcoef(found)[0, 1] > 0.8


def test_it_appears_in_every_table_of_pictures(joined):
    out, results = joined
    page = (out / "results.html").read_text(encoding="utf-8")
    for table in tables_of(results, groups_of(results)[0]):
        if table.key not in {"motion", "own_ceiling", "modes", "cost"}:
            assert "blend" in [row[0] for row in table.rows], table.key
            assert "blend" in (out / "tables" / f"1_{table.key}.tex").read_text(encoding="utf-8")
    assert "blend" in (out / "results.md").read_text(encoding="utf-8")
    assert page.count("blend") > 5


def test_its_scores_are_what_the_example_does(joined):
    """It mixes the neighbours in time, so it loses some of the motion."""
    (line,) = [x for x in joined[1]["lines"] if x["row"] == "blend"]
    assert list(line["alphas"]) == ["0", "5", "20"]
    assert 0.2 < line["alphas"]["5"]["gain"] < 0.98


def run_linear(data, out, *more, page=False):
    """Exit status and results of the quickest method; without the page, which takes longest."""
    with pytest.MonkeyPatch.context() as patch:
        if not page:
            patch.setattr("tg4mm.research.bench.scenes.write_page", lambda *_: None)
        status = main(["bench", "scenes", str(data), *more, "--out", str(out), "--methods", "linear-2d"])
    return status, json.loads((out / "results.json").read_text(encoding="utf-8"))


def test_a_job_may_fail_by_any_error_and_leaves_its_traceback(data, tmp_path, capsys, monkeypatch):
    from tg4mm.research.bench.methods.video import Phase2D

    def broken(*arguments):
        raise ArithmeticError("a matrix is singular\nsecond line")

    monkeypatch.setattr(Phase2D, "fit", broken)
    out = tmp_path / "out"
    arguments = ["bench", "scenes", str(data), "--out", str(out), "--methods", "phase-2d,linear-2d"]
    assert main(arguments) == 1
    (failed,) = json.loads((out / "results.json").read_text(encoding="utf-8"))["failed"]
    assert failed["why"].startswith("ArithmeticError: a matrix is singular (")
    assert "in broken" in (out / "runs" / data.name / "phase-2d" / "traceback.txt").read_text(
        encoding="utf-8"
    )


def test_a_job_finds_and_leaves_its_results_where_the_tables_look(data, tmp_path, capsys, monkeypatch):
    """Two datasets of one name: the name in the tables does not depend on which others are named beside it."""
    out, other = tmp_path / "out", tmp_path / "other" / data.name
    shutil.copytree(data, other)
    named = f"second={other}"
    for given in (str(data), named):
        assert main(["bench", "job", given, "linear-2d", "--out", str(out), "--methods", "linear-2d"]) == 0
    places = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert places == [out / "runs" / name / "linear-2d" for name in (data.name, "second")]

    def forbidden(*_):
        raise AssertionError("done again")

    monkeypatch.setattr("tg4mm.research.bench.jobs.write_png", forbidden)
    status, results = run_linear(data, out, named)
    assert (status, [s["label"] for s in results["sets"]]) == (0, [data.name, "second"])


def test_results_of_another_dataset_of_that_name_are_not_overwritten(data, tmp_path, capsys):
    out, other = tmp_path / "out", tmp_path / "other" / data.name
    run_linear(data, out)
    shutil.copytree(data, other)
    scene = json.loads((other / "scene.json").read_text(encoding="utf-8"))
    (other / "scene.json").write_text(json.dumps(scene | {"seed": 17}))
    assert main(["bench", "job", str(other), "linear-2d", "--out", str(out)]) == 2
    assert "holds results of another one of that name" in capsys.readouterr().err


def test_collecting_runs_nothing_and_says_what_is_not_there(data, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    run_linear(data, out)

    def forbidden(*_):
        raise AssertionError("something is run")

    monkeypatch.setattr("tg4mm.research.bench.jobs.write_png", forbidden)
    monkeypatch.setattr("tg4mm.research.bench.jobs.score_pictures", forbidden)
    monkeypatch.setattr("tg4mm.research.bench.measure.train", forbidden)
    arguments = [
        "bench",
        "scenes",
        str(data),
        "--out",
        str(out),
        "--methods",
        "modal,3dmm,linear-2d",
        "--collect",
    ]
    assert main(arguments) == 1
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert [(f["method"], f["why"]) for f in results["failed"]] == [
        (method, f"{method} on {data.name} is not finished, or was made with other settings or pictures")
        for method in ("modal", "3dmm")
    ]
    assert [line["row"] for line in results["lines"]] == ["linear-2d"]
    assert (out / "results.html").is_file()


def test_ground_truth_that_has_changed_is_scored_against(data, tmp_path):
    own, out = tmp_path / data.name, tmp_path / "out"
    shutil.copytree(data, own)
    before = run_linear(own, out)[1]["lines"][0]["alphas"]
    for picture in (own / "magnified" / "x020").rglob("test/*.png"):
        shutil.copyfile(own / "000" / "test" / picture.name, picture)
    after = run_linear(own, out)[1]["lines"][0]["alphas"]
    assert after["5"] == before["5"]
    assert after["20"]["psnr_db"] != before["20"]["psnr_db"]


def test_pictures_that_have_changed_are_magnified_anew(data, tmp_path):
    """A 2D method sees the test views unmagnified, which no digest of the dataset covers."""
    own, out = tmp_path / data.name, tmp_path / "out"
    shutil.copytree(data, own)
    before = run_linear(own, out)[1]["lines"][0]["alphas"]
    assert run_linear(own, out, "--collect")[0] == 0
    first = (own / "000" / "test" / "r_000.png").read_bytes()
    for picture in own.glob("[0-9]*/test/r_000.png"):
        picture.write_bytes(first)
    assert run_linear(own, out, "--collect")[0] == 2  # nothing is finished
    after = run_linear(own, out)[1]["lines"][0]["alphas"]
    assert before["20"]["gain"] > 0.05
    assert after["20"]["gain"] == pytest.approx(0, abs=0.01)  # a still video


def test_methods_join_a_dataset_of_exr_pictures_by_png(data, tmp_path):
    exr = pytest.importorskip("OpenEXR")
    own, theirs = tmp_path / data.name, tmp_path / "theirs"
    shutil.copytree(data, own)
    shutil.copytree(data, theirs / data.name)
    for path in own.rglob("test/*.png"):
        coded, opacity = np.split(np.asarray(Image.open(path).convert("RGBA"), np.float32) / 255, [3], axis=2)
        linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4) * opacity
        values = np.concatenate([linear, opacity], axis=2)
        channels = {name: np.ascontiguousarray(values[..., i]) for i, name in enumerate("RGBA")}
        with exr.File({"type": exr.scanlineimage}, channels) as file:
            file.write(str(path.with_suffix(".exr")))
        path.unlink()
    status, results = run_linear(own, tmp_path / "out", "--external", f"theirs={theirs}", page=True)
    assert status == 0
    lines = {line["row"]: line["alphas"] for line in results["lines"]}
    assert lines["linear-2d"]["0"]["ssim"] == pytest.approx(1, abs=1e-3)
    assert lines["theirs"]["20"]["ssim"] == pytest.approx(1, abs=1e-3)
    assert "<video" in (tmp_path / "out" / "results.html").read_text(encoding="utf-8")


def other_bytes(path):
    raw = bytearray(path.read_bytes())
    raw[-1] ^= 1
    path.write_bytes(raw)


def move_a_test_camera(path):
    cameras = json.loads(path.read_text())
    cameras["frames"][0]["transform_matrix"][0][3] += 0.5
    path.write_text(json.dumps(cameras))


@pytest.mark.parametrize(
    ("change", "what"),
    [(other_bytes, "003/train/r_000.png"), (move_a_test_camera, "003/transforms_test.json")],
)
def test_a_dataset_whose_training_data_or_cameras_have_changed_is_refused(change, what, data, tmp_path):
    own, out = shutil.copytree(data, tmp_path / data.name), tmp_path / "out"
    assert run_linear(own, out)[0] == 0
    copied = shutil.copytree(own, tmp_path / "copied" / data.name, copy_function=shutil.copyfile)
    assert run_linear(copied, out)[0] == 0
    change(own / what)
    assert main(["bench", "job", str(own), "linear-2d", "--out", str(out), "--methods", "linear-2d"]) == 2


def spoilt_at_20(data, theirs, content):
    """All of a method's pictures of the dataset, one of them at α = 20 with other content, or not there."""
    for part in ("magnified", *(f"{t:03d}" for t in range(6))):
        shutil.copytree(data / part, theirs / data.name / part)
    picture = theirs / data.name / "magnified" / "x020" / "003" / "test" / "r_000.png"
    picture.unlink()
    if content is not None:
        picture.write_bytes(content)
    return picture


def encoded(kind, size):
    buffer = io.BytesIO()
    Image.new("RGB", size).save(buffer, kind)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "does not exist: if there is any picture at an α, all pictures at that α are needed"),
        (encoded("PNG", (16, 32)), "is 16×32 pixels, expected 32×32"),
        (encoded("JPEG", (32, 32)), "is no PNG file"),
    ],
)
def test_a_bad_picture_takes_its_alpha_along_and_no_more(content, message, data, tmp_path, capsys):
    """And it is said before anything is run."""
    spoilt_at_20(data, tmp_path / "theirs", content)
    status, results = run_linear(data, tmp_path / "out", "--external", f"theirs={tmp_path / 'theirs'}")
    said = capsys.readouterr().err
    assert said.index(f"theirs will fail: {tmp_path}") < said.index(f"{data.name}, linear-2d")
    (failed,) = results["failed"]
    assert (status, failed["method"]) == (1, "theirs")
    assert failed["why"].startswith("α = 20: ")
    assert message in failed["why"]
    assert {x["row"]: list(x["alphas"]) for x in results["lines"]} == {
        "linear-2d": ["0", "5", "20"], "theirs": ["0", "5"],
    }  # fmt: skip
    collected = run_linear(data, tmp_path / "out", "--external", f"theirs={tmp_path / 'theirs'}", "--collect")
    assert [list(x["alphas"]) for x in collected[1]["lines"]] == [["0", "5", "20"], ["0", "5"]]


def test_scores_are_of_the_weights_and_programs_as_they_are(data, tmp_path, monkeypatch):
    """LPIPS by weights in a file, video quality by a program: both are in the scores, and change with the files."""
    weights, program = tmp_path / "alex.pth", tmp_path / "test_video.py"
    monkeypatch.setattr(
        "tg4mm.research.bench.jobs.load_lpips", lambda files: lambda made, truth: float(files[0].read_text())
    )
    opened, method = open_set(data, data.name), Linear2D()

    def scored(lpips, quality):
        weights.write_text(lpips)
        program.write_text(f"print('score', {quality})")
        plan = BenchPlan(alphas=(5.0,), lpips_weights=(weights,))
        vqa = checkouts({"md_vqa": tmp_path}, sys.executable)
        _, (line,) = run_job(method, opened, tmp_path / "out", plan, vqa)
        return line.alphas["5"]["lpips"], line.alphas["5"]["md_vqa"]

    assert scored("0.25", "81.5") == (0.25, 81.5)
    assert scored("0.125", "81.5") == (0.125, 81.5)
    assert scored("0.125", "9.25") == (0.125, 9.25)


@pytest.fixture(scope="module")
def pointed(data, tmp_path_factory):
    root = tmp_path_factory.mktemp("points") / data.name
    shutil.copytree(data, root)
    truth = load_truth(root, 30.0, 6)
    points = np.concatenate([o.rest[::7] for o in truth.objects]).astype(np.float32)
    write_ply(root / "points3d.ply", points, np.zeros_like(points), np.full_like(points, 0.5))
    return root


def exact(root):
    truth = load_truth(root, 30.0, 6)
    gains = np.exp(2j * np.pi * np.outer(truth.freqs_hz, np.arange(6)) / 30)
    modes = np.concatenate([o.modes[:, ::7] for o in truth.objects], axis=1)
    return np.einsum("kt,knj->tnj", gains, modes).real


def hand_in(root, folder, **arrays):
    (folder / root.name).mkdir(parents=True)
    np.savez(folder / root.name / "displacement.npz", **arrays)
    return ["bench", "scenes", str(root), "--methods", "", "--external", f"theirs={folder}", "--out"]


def test_true_displacements_have_no_error_and_their_double_has_all(pointed, tmp_path):
    for factor, expected in ((1.0, 0.0), (2.0, 1.0)):
        place = tmp_path / f"{factor:g}"
        command = hand_in(pointed, place / "theirs", displacement=factor * exact(pointed))
        assert main([*command, str(place / "out")]) == 0
        results = json.loads((place / "out" / "results.json").read_text())
        (run,) = results["runs"]
        assert run["displacement"]["relative_error"] == pytest.approx(expected, abs=1e-6)
        assert run["displacement"]["per_frequency"][0]["amplitude_ratio"] == pytest.approx(factor)
        assert "theirs" in (place / "out" / "results.md").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"displacements": d}, "holds displacements; expected displacement alone"),
        (lambda d: {"displacement": d[:, 1:]}, r"has shape \(6, \d+, 3\), expected \(6, \d+, 3\)"),
        (lambda d: {"displacement": d.astype(int)}, "has type int64, expected finite floating-point numbers"),
        (lambda d: {"displacement": d * np.nan}, "expected finite floating-point numbers"),
    ],
)
def test_displacements_that_are_refused(pointed, change, message, tmp_path, capsys):
    command = hand_in(pointed, tmp_path / "theirs", **change(exact(pointed)))
    assert main([*command, str(tmp_path / "out")]) == 2
    assert re.search(message, capsys.readouterr().err.splitlines()[-1])


@pytest.fixture
def folder(data, tmp_path):
    shutil.copytree(data, tmp_path / "sets" / "seed0" / data.name)
    assert main(["bench", "release", str(tmp_path / "sets"), "--version", "1.2"]) == 0
    return tmp_path / "sets"


def test_what_is_passed_on_can_be_checked(folder, data, capsys):
    card = (folder / "README.md").read_text()
    assert 'version: "1.2"' in card
    assert f"| seed0/{data.name} |" in " ".join(card.split())
    described = json.loads((folder / "croissant.json").read_text(encoding="utf-8"))
    (record,) = described["recordSet"][0]["data"]
    assert (record["sets/set"], record["sets/timesteps"]) == (f"seed0/{data.name}", 6)
    assert main(["bench", "verify", str(folder)]) == 0
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=folder, check=True)
    root = folder / "seed0" / data.name
    (root / "truth" / "motion.npz").write_bytes(b"other")
    (root / "scene.json").unlink()
    (root / "new.txt").touch()
    capsys.readouterr()
    assert main(["bench", "verify", str(folder)]) == 1
    place = f"seed0/{data.name}"
    assert capsys.readouterr().out.splitlines() == [
        f"{place}/scene.json: missing",
        f"{place}/new.txt: is not in SHA256SUMS",
        f"{place}/truth/motion.npz: changed",
    ]


@pytest.mark.parametrize(
    ("sums", "message"),
    [
        (None, "SHA256SUMS cannot be read, tg4mm bench release writes it"),
        ("0" * 64 + "  ../a\n", "line 1: .* is not a checksum and a name below the folder"),
        ("hello\n", "line 1: 'hello' is not"),
    ],
)
def test_a_list_that_will_not_do(sums, message, tmp_path, capsys):
    if sums is not None:
        (tmp_path / "SHA256SUMS").write_text(sums)
    assert main(["bench", "verify", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert re.search(message, err)
    assert err.count("\n") == 1


def test_the_metadata_are_valid_croissant(folder):
    """And the card's head is one of Hugging Face."""
    croissant, hub = pytest.importorskip("mlcroissant"), pytest.importorskip("huggingface_hub")
    (record,) = croissant.Dataset(folder / "croissant.json").records("sets")
    assert record["sets/set"].startswith("seed0/")
    card = hub.DatasetCard.load(folder / "README.md")
    assert (card.data.license, card.data.pretty_name) == ("gpl-3.0", "sets")


def test_a_folder_without_datasets_has_no_card(tmp_path, capsys):
    assert main(["bench", "release", str(tmp_path)]) == 2
    assert "holds no dataset" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
