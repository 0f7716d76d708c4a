"""The page in a real browser: the picture answers to sliders, the spectrum and the picture to clicks."""

import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.show.view.browser import browser
from tg4mm.core.magnification import Magnification
from tg4mm.show.analyse import read_channels
from tg4mm.show.view.app import App, canvas_of
from tg4mm.show.view.charts import LEFT, RIGHT, WIDTH
from tg4mm.show.view.session import DisplaySettings, PlaybackClock, Session

WAIT = 60.0  # seconds; software drawing on a busy machine


@dataclass
class Opened:
    """A page that shows a paused scene, and what it asked the network for."""

    page: Any
    app: App
    session: Session
    folder: Path
    hosts: set[str]
    errors: list[str]

    def picture(self):
        """[H, W, 3] int: the canvas as it is on the screen."""
        box = self.page.locator("canvas").first.bounding_box()
        clip = {"x": 0, "y": 200, "width": box["width"], "height": box["height"] - 200}  # below notices
        return np.asarray(Image.open(io.BytesIO(self.page.screenshot(clip=clip))).convert("RGB")).astype(int)

    def settled(self):
        """The picture once it changes no more."""
        last = self.picture()
        for _ in range(30):
            time.sleep(0.4)
            now = self.picture()
            if now.min() < 200 and np.array_equal(now, last):
                return now
            last = now
        raise AssertionError("the picture does not settle")

    def pixel_of(self, point):
        """Where a point [3] lies on the page."""
        (client, _), *_ = self.app._screens.values()
        canvas = canvas_of(client)
        camera = canvas.camera((canvas.width, canvas.height))
        u, v, depth = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
        return u / depth, v / depth


def until(holds, what):
    end = time.monotonic() + WAIT
    while not holds():
        assert time.monotonic() < end, f"waited in vain: {what}"
        time.sleep(0.1)


@pytest.fixture(scope="module")
def opened(scene, tmp_path_factory):
    session = Session(
        scene, DisplaySettings(Magnification.of(0.0)), PlaybackClock(scene.duration, offset=0.1)
    )
    folder = tmp_path_factory.mktemp("saved")
    with browser() as chromium:
        app = App(session, 0, folder)
        try:
            page = chromium.new_page(viewport={"width": 1000, "height": 700})
            hosts, errors = set[str](), list[str]()
            page.on("request", lambda r: hosts.add(r.url.split("/")[2]) if r.url.startswith("http") else None)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.goto(app.url)
            until(lambda: bool(app._screens), "the page says where its camera is")
            one = Opened(page, app, session, folder, hosts, errors)
            page.locator(".mantine-Notification-closeButton").click()  # viser's word on drawing in software
            one.settled()
            yield one
        finally:
            app.stop()


def test_the_magnification_slider_changes_the_picture(opened):
    before = opened.settled()
    slider = opened.page.get_by_role("slider").first
    slider.focus()
    slider.press("End")
    until(lambda: opened.session.look.magnified.alpha == 100.0, "α is at the slider's end")
    after = opened.settled()
    assert (np.abs(after - before).max(axis=-1) > 40).mean() > 0.002
    slider.press("Home")
    until(lambda: opened.session.look.magnified.alpha == -1.0, "α is at the slider's start")
    assert np.abs(opened.settled() - after).max() > 40


def test_a_click_on_a_peak_sets_the_band(opened):
    opened.page.locator('rect.hit[data-peak="5 Hz"]').first.click()
    until(lambda: opened.session.band == (4.5, 5.5), "the band is around 5 Hz")
    opened.page.get_by_text("1 of 2 frequencies").wait_for(timeout=WAIT * 1e3)
    opened.page.get_by_role("button", name="all").click()
    until(lambda: opened.session.band is None, "all frequencies again")


def test_over_the_spectrum_the_pointer_reads_and_a_drag_sets_the_band(opened):
    chart = opened.page.locator('svg[aria-label^="spectrum: peak"]').first
    boxes = []
    until(lambda: boxes.append(chart.bounding_box()) or boxes[-1], "the spectrum is drawn")
    box = boxes[-1]  # a chart that is drawn again is gone for a moment, and stays where it is

    def place(hz):
        share = (LEFT + hz / (opened.session.scene.motion.fps / 2) * (WIDTH - LEFT - RIGHT)) / WIDTH
        return box["x"] + share * box["width"], box["y"] + 0.4 * box["height"]

    def reads_5_hz():  # a chart that is drawn again loses the pointer until it moves
        for hz in (4.0, 5.0):
            opened.page.mouse.move(*place(hz))
        return opened.page.locator("g.cursor text", has_text="5 Hz: ").is_visible()

    until(reads_5_hz, "the pointer reads 5 Hz")
    opened.page.mouse.move(*place(2.0))
    opened.page.mouse.down()
    opened.page.mouse.move(*place(3.0), steps=5)
    opened.page.mouse.up()
    until(lambda: opened.session.band is not None, "the band is the drag's")
    assert opened.session.band == pytest.approx((2.0, 3.0), abs=0.1)
    opened.page.get_by_role("button", name="all").click()
    until(lambda: opened.session.band is None, "all frequencies again")


def test_a_clicked_pixel_answers_with_its_waveform(opened, scene):
    k = scene.strongest(Magnification.of(1.0, (4.0, 6.0)))
    moves = np.abs(scene.motion.displacement[k]).max(axis=1) > 1e-4
    opened.page.mouse.click(*opened.pixel_of(scene.gaussians.means.numpy()[moves].mean(axis=0)))
    opened.page.get_by_text("mm at 5 Hz").wait_for(timeout=WAIT * 1e3)
    assert opened.page.locator('svg[aria-label^="waveform"] polyline.curve').count() == 1


def test_colours_follow_the_choice(opened):
    before = opened.settled()
    opened.page.get_by_role("combobox", name="Colour by").click()
    opened.page.get_by_role("option", name="amplitude").click()
    opened.page.get_by_text("as captured").first.wait_for(timeout=WAIT * 1e3)
    assert np.abs(opened.settled() - before).max() > 60


def test_play_moves_the_picture(opened):
    opened.page.get_by_role("slider").first.press("End")
    opened.settled()
    opened.page.get_by_role("button", name="Play").click()
    until(lambda: opened.session.clock.playing, "it plays")
    first = opened.picture()
    until(lambda: np.abs(opened.picture() - first).max() > 40, "the picture moves")
    opened.page.get_by_role("button", name="Pause").click()
    until(lambda: not opened.session.clock.playing, "it stands")


def test_the_scene_as_captured_is_shown_beside_the_magnified_one(opened):
    opened.page.get_by_role("button", name="Pause").or_(
        opened.page.get_by_role("button", name="Play")
    ).wait_for()
    opened.session.magnify(100.0)
    opened.page.locator("canvas").last.focus()
    opened.page.keyboard.press("b")
    until(lambda: opened.session.look.beside, "the key presses the button")
    seen = opened.settled()
    middle = opened.page.locator("canvas").first.bounding_box()["width"] // 2
    left, right = seen[:, : int(middle) - 2], seen[:, int(middle) + 2 : 2 * int(middle) - 2]
    wide = min(left.shape[1], right.shape[1])
    assert np.abs(left[:, :wide] - right[:, :wide]).max() > 40
    opened.session.magnify(0.0)
    seen = opened.settled()
    left, right = seen[:, : int(middle) - 2], seen[:, int(middle) : 2 * int(middle) - 2]
    assert np.median(np.abs(left - right)) <= 2
    opened.page.get_by_role("button", name="Side by side").click()
    until(lambda: not opened.session.look.beside, "one picture again")


def test_buttons_write_files(opened):
    opened.page.get_by_role("button", name="Numbers").click()
    until(lambda: (opened.folder / "waveform_0001.csv").is_file(), "a waveform")
    until(lambda: (opened.folder / "spectrum_0001.csv").is_file(), "a spectrum")
    assert (opened.folder / "spectrum_0001.csv").read_text().startswith("frequency_hz,along_mm")
    assert read_channels(opened.folder / "waveform_0001.csv")[0].unit == "mm"
    opened.page.get_by_role("button", name="Snapshot").click()
    until(lambda: (opened.folder / "snapshot_0001.png").is_file(), "a snapshot")
    opened.page.get_by_role("button", name="Clip").click()
    until(lambda: (opened.folder / "clip_0001.mp4").is_file(), "a clip")


def test_the_page_asks_no_one_else_and_has_no_errors(opened):
    assert opened.hosts == {opened.app.url.split("/")[2]}
    assert not opened.errors
