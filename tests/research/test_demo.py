"""The demo's order, resuming and refusals; generating and training are replaced by quick exact ones."""

import json

import pytest

import tg4mm.research.demo as demo
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.splatfile import read_splat
from tg4mm.run import Run


class Said(list):
    """Collects what the demo says."""

    def __call__(self, text):
        self.append(text)

    def count(self, words):
        return sum(words in line for line in self)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The demo's folder and words, of a dataset made without Blender and its exact model in place of a trained one."""
    made = {}

    def generate(places, size, full):
        options = {"n_views": 3, "n_timesteps": 6, "size": size, "freqs": (5.0,), "alphas": (20,)}
        made["model"] = make_synthetic_dataset(places.data / "sway_5Hz_0_02", **options)

    def train(places):
        run = Run.create(places.run, places.dataset, "modal", {})
        run.save_space(made["model"][0], {"seconds": 1.0})
        run.save_motion(made["model"][1], {"seconds": 1.0})

    out = tmp_path_factory.mktemp("made") / "demo"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "_generate", generate)
        patch.setattr(demo, "_train", train)
        patch.setattr(demo, "ORBIT_FRAMES", 4)
        report = demo.run_demo(out, 32, say=(said := Said()))
    assert report == out / "report.html"
    return out, said


def test_the_demo_makes_everything_and_a_second_call_makes_nothing(made, monkeypatch):
    monkeypatch.setattr(demo, "ORBIT_FRAMES", 4)
    out, said = made
    report = out / "report.html"
    text = report.read_text(encoding="utf-8")
    assert text.count("<video ") == 4
    assert "splat file" in text
    assert read_splat(out / "splat.ply").n_modes == 1
    names = {"data", "run", "magnified", "orbit", "splat.ply", "report.html", "demo.json"}
    assert {path.name for path in out.iterdir()} == names
    assert said.count("already done") == 0
    assert said.count(str(report)) == 1
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    demo.run_demo(out, 32, say=(said := Said()))
    assert said.count("already done") == 7
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == before


def test_another_size_or_a_foreign_folder_is_refused(made, tmp_path):
    out = made[0]
    with pytest.raises(Tg4mmError, match=r"was made with size = 32, not 48"):
        demo.run_demo(out, 48, say=Said())
    with pytest.raises(Tg4mmError, match="is a file"):
        demo.run_demo(out / "splat.ply", 32, say=Said())
    (tmp_path / "mine" / "data").mkdir(parents=True)
    with pytest.raises(Tg4mmError, match=r"is not empty and holds no demo\.json"):
        demo.run_demo(tmp_path / "mine", 32, say=Said())
    for size in (4, 100_000):
        with pytest.raises(Tg4mmError, match=f"--size {size}: expected 16 … 4096 pixels"):
            demo.run_demo(tmp_path / "c", size, say=Said())
    assert not (tmp_path / "c").exists()


def test_a_generator_that_fails_stops_the_demo(tmp_path, monkeypatch):
    import tg4mm.research.generator as generator

    monkeypatch.setattr(generator, "run_generator", lambda arguments: 2)
    with pytest.raises(Tg4mmError, match="status 2"):
        demo.run_demo(tmp_path, 32, say=Said())
    assert json.loads((tmp_path / "demo.json").read_text())["done"] == {"generate": {"asked": {}}}
