"""Regions drawn before there is a run: what clicks make, what texture tells, and the page in a real browser."""

import time

import numpy as np
import pytest

from tests.capture.sfm.videos import write_video
from tests.show.view.browser import browser
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.regions import Region, read_regions, write_regions
from tg4mm.show.view.desk import Desk
from tg4mm.show.view.drawing import Drawing, drawn, opened, texture_of

SIZE = (160, 120)


def clicks(drawing, *places):
    for place in places:
        drawing = drawing.clicked(place)
    return drawing


def test_clicks_make_regions_and_a_scale(tmp_path):
    drawing = clicks(Drawing(SIZE), (60, 50), (20, 30))
    drawing = clicks(drawing.taking("point"), (80, 80))
    drawing = clicks(drawing.taking("polygon"), (10, 90), (60, 90), (30, 110)).finished()
    ruler = Drawing(SIZE, drawing.regions, tool="length", sides_mm=(200.0, 0.0))
    drawing = clicks(ruler, (10, 10), (110, 10))
    assert [region.name for region in drawing.regions] == ["region 1", "region 2", "region 3"]
    assert [region.shape for region in drawing.regions] == ["box", "point", "polygon"]
    assert drawing.regions[0].values == (20, 30, 60, 50)
    assert drawing.scale.reference_m == pytest.approx(0.002)
    write_regions(tmp_path / "r.json", drawing.as_file())
    assert opened(read_regions(tmp_path / "r.json")).regions == drawing.regions
    assert len(clicks(drawing.taking("box"), (1, 1), (30, 30)).undone().undone().regions) == 3
    box = drawing.taking("box").dragged((5, 5), (30, 40))
    assert (box.regions[-1].values, box.undone().regions) == ((5, 5, 30, 40), drawing.regions)
    with pytest.raises(Tg4mmError, match="a box is dragged with the tool box"):
        drawing.taking("polygon").dragged((5, 5), (30, 40))


@pytest.mark.parametrize(
    ("tool", "places", "said"),
    [
        ("box", [(10, 10), (10, 40)], "has no area"),
        ("polygon", [(10, 10), (20, 20)], "3 corners or more"),
        ("length", [(10, 10), (20, 20)], "millimetres first"),
        ("rectangle", [(10, 10), (90, 10), (90, 90), (10, 90)], "millimetres first"),
    ],
)
def test_what_cannot_be_drawn_is_said(tool, places, said):
    with pytest.raises(Tg4mmError, match=said):
        clicks(Drawing(SIZE, tool=tool), *places).finished()


def scene():
    """Plain on the left, an upright edge in the middle, texture on the right; 12 pictures with noise of 1 level."""
    rng = np.random.default_rng(0)
    grey = np.full((SIZE[1], SIZE[0]), 100.0)
    grey[:, 56:] = 140.0
    grey[:, 96:] += 25 * rng.normal(size=(SIZE[1], SIZE[0] - 96))
    return np.clip(grey + rng.normal(size=(12, *grey.shape)), 0, 255)


def test_texture_tells_where_and_along_what_motion_can_be_measured():
    texture = texture_of(scene().astype(np.float32))
    boxes = {
        "plain": (0, 16, 32, 80),
        "edge": (48, 16, 64, 80),
        "full": (112, 16, 160, 80),
        "dot": (3, 3, 6, 6),
    }
    words = {name: texture.words(Region(name, "box", box), SIZE) for name, box in boxes.items()}
    assert words["plain"] == "no texture: nothing can be measured here"
    assert words["edge"].startswith("an edge: ± ")
    assert "along +1.00 right" in words["edge"]
    assert "across it" in words["full"]
    assert "smaller than" in words["dot"]
    shown = drawn(np.full((SIZE[1], SIZE[0], 3), 100, np.uint8), Drawing(SIZE), texture, 2.0)
    assert shown.shape == (2 * SIZE[1], 2 * SIZE[0], 3)
    assert np.ptp(shown[40, 280].astype(int)) > 20
    assert np.ptp(shown[40, 20]) == 0


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    pytest.importorskip("av", reason="needs the extra sfm")
    frames = [np.repeat(grey[..., None], 3, 2).astype(np.uint8) for grey in np.tile(scene(), (3, 1, 1))]
    return write_video(tmp_path_factory.mktemp("video") / "wall.mp4", frames, 25, crf=8)


def test_a_box_is_drawn_and_saved_in_the_browser(video, tmp_path):
    file = tmp_path / "r.json"
    with browser() as chromium:
        desk = Desk(video, file, None, 0, None)
        try:
            page = chromium.new_page(viewport={"width": 1000, "height": 600})
            errors = []
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.goto(desk.url)
            page.get_by_text("click two opposite corners").wait_for(timeout=60e3)
            page.locator(".mantine-Notification-closeButton").click()
            end = time.monotonic() + 60
            while not desk.server.get_clients() and time.monotonic() < end:
                time.sleep(0.1)
            (client,) = desk.server.get_clients().values()
            scale, left, upper, *_ = desk._fit(client)
            for x, y in ((112, 20), (150, 70)):
                page.mouse.click(left + x * scale, upper + y * scale)
                time.sleep(0.5)
            page.get_by_text("region 1").wait_for(timeout=60e3)
            page.mouse.move(left + 50 * scale, upper + 90 * scale)
            page.mouse.down()
            page.mouse.move(left + 20 * scale, upper + 60 * scale, steps=5)
            page.mouse.up()
            page.get_by_text("region 2").wait_for(timeout=60e3)
            page.locator("canvas").last.focus()
            page.keyboard.press("s")
            page.get_by_text("Wrote").wait_for(timeout=60e3)
            clicked, dragged = (region.values for region in read_regions(file).regions)
            assert clicked == pytest.approx((112, 20, 150, 70), abs=1)
            assert dragged == pytest.approx((20, 60, 50, 90), abs=1)
            assert errors == []
        finally:
            desk.stop()


@pytest.mark.parametrize("what", ["gone.mp4", "notes.txt", "empty"])
def test_what_is_no_recording_is_one_line(tmp_path, capsys, what):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    assert main(["view", str(tmp_path / what), "--no-open", "--port", "0"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_region_without_texture_is_refused_and_nothing_is_written(video, tmp_path, capsys):
    write_regions(tmp_path / "r.json", Drawing(SIZE, (Region("sky", "box", (0, 16, 40, 80)),)).as_file())
    out = tmp_path / "out"
    assert main(["look", str(video), "--regions", str(tmp_path / "r.json"), "--out", str(out)]) == 2
    assert "region 'sky' has no texture" in capsys.readouterr().err
    assert not out.exists()
