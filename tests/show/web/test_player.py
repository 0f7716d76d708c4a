"""The page in headless Chromium: our rasteriser's pictures, working controls, no use of the network."""

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

from tests.helpers.motion_animate import alphas
from tg4mm.capture import load_capture
from tg4mm.fit.motion.animate import animate
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.render.image import render_image
from tg4mm.show.web.write import camera_json, export_html

pytestmark = pytest.mark.slow
LEAST_DB = 35.0


def psnr(a, b):
    return float(-10 * np.log10(max(np.mean((a.astype(np.float64) - b) ** 2), 1e-12)))


def opened(browser, file, address="", **options):
    """The page, ready; what it complained of and asked for stands in `.complaints` and `.requests`."""
    page = browser.new_page(viewport={"width": 700, "height": 500}, **options)
    page.set_default_timeout(120_000)
    page.complaints, page.requests = [], []
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.on("request", lambda request: page.requests.append(request.url))
    page.goto(file.resolve().as_uri() + address)
    page.evaluate("() => tg4mm.ready.then(() => true, () => false)")
    return page


@pytest.fixture(scope="module")
def page(browser, page_file):
    page = opened(browser, page_file, "#paused")
    yield page
    page.close()


@pytest.fixture(scope="module")
def camera(moving_run):
    return capture_cameras(load_capture(moving_run.dataset))[0]


def picture(page, camera, **state):
    url = page.evaluate(
        "wanted => tg4mm.picture(wanted)", {"camera": camera_json(camera), "band": None, **state}
    )
    data = base64.b64decode(url.removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.float32) / 255


def ours(run, camera, time, alpha, band=None):
    motion = run.load_motion()
    moved = animate(run.load_space(), motion, time, 0.0 if motion is None else alphas(motion, alpha, band))
    return render_image(moved, camera.viewmat, camera.K, camera.width, camera.height)


@pytest.mark.parametrize(
    ("alpha", "time", "band"),
    [(0, 0, None), (0, 4, None), (20, 2.5, None), (20, 7, (2.0, 4.0)), (20, 7, (5.0, 7.0)), (-1, 3, None)],
)
def test_pictures_are_our_rasterisers(page, moving_run, camera, alpha, time, band):
    drawn = picture(page, camera, alpha=alpha, time=time, band=band)
    assert psnr(drawn, ours(moving_run, camera, time, alpha, band)) >= LEAST_DB


def test_the_page_asks_nothing_of_any_network(page, page_file):
    assert page.requests[0].startswith(page_file.resolve().as_uri())
    assert all(url.startswith(("blob:", "data:")) for url in page.requests[1:])
    assert page.complaints == []


def test_it_opens_with_a_camera_of_the_capture(browser, moving_run, tmp_path):
    """The canvas, of a window of the camera's own size, holds that camera's picture."""
    page = opened(browser, export_html(moving_run, tmp_path / "a.html"), "#paused&alpha=20&time=2.5")
    scene = page.evaluate("() => tg4mm.scene")
    size = scene["camera"]["width"]
    page.evaluate(
        f"() => {{ const s = document.getElementById('stage').style; s.width = s.height = '{size}px'; }}"
    )
    page.evaluate("() => new Promise((done) => setTimeout(done, 300)).then(() => tg4mm.show({}))")
    shot = page.locator("canvas").screenshot()
    drawn = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), np.float32) / 255
    first = next(
        c for c in capture_cameras(load_capture(moving_run.dataset)) if c.name == scene["camera"]["name"]
    )
    assert psnr(drawn, ours(moving_run, first, 2.5, 20)) >= LEAST_DB
    page.close()


def test_controls_set_what_is_shown(page):
    page.evaluate("() => tg4mm.show({ alpha: 5, time: 0, band: null })")
    assert page.locator("#alpha").input_value() == "5"
    assert page.locator("#alpha-hint").inner_text() == "A displacement is shown 6 times as large."
    page.locator("#alpha-number").fill("12.5")
    page.get_by_role("button", name="3 Hz").click()
    state = page.evaluate("() => tg4mm.state()")
    assert state["alpha"] == 12.5
    assert state["band"][0] < 3 < state["band"][1] < 6
    assert page.locator("#spectrum rect.in").count() == 1
    page.locator("#band-high").fill(str(15))
    assert page.evaluate("() => tg4mm.state().band[1]") == 15
    page.get_by_role("button", name="all").click()
    assert page.evaluate("() => tg4mm.state().band") is None
    page.get_by_role("button", name="½").click()
    assert page.evaluate("() => tg4mm.state().speed") == 0.5


def test_dragging_turns_the_scene_and_reset_turns_it_back(page):
    page.evaluate("() => tg4mm.show({ time: 0, alpha: 0 })")

    def shot():
        page.evaluate("() => tg4mm.show({})")
        data = io.BytesIO(page.locator("canvas").screenshot())
        return (
            np.asarray(Image.open(data).convert("RGB"), np.float32)[5:-5, 5:-5] / 255
        )  # less the focus ring

    before = shot()
    page.mouse.move(200, 250)
    page.mouse.down()
    page.mouse.move(320, 280, steps=4)
    page.mouse.up()
    assert psnr(shot(), before) < 30
    page.get_by_role("button", name="Reset view").click()
    assert psnr(shot(), before) > 60


def test_a_run_without_motion_is_shown_still(browser, still_run, camera, tmp_path):
    page = opened(browser, export_html(still_run, tmp_path / "still.html"))
    assert page.locator("#still").is_visible()
    assert not page.locator("#motion").is_visible()
    drawn = picture(page, camera)
    assert psnr(drawn, ours(still_run, camera, 0, 0)) >= LEAST_DB
    assert page.complaints == []
    page.close()


def test_as_many_fields_as_a_page_holds_are_drawn(browser, moving_run, camera, tmp_path):
    """48 modes that have nothing to do with each other: 96 fields."""
    n, rng = len(moving_run.load_space()), np.random.default_rng(1)
    noise = rng.normal(0, 5e-4, (2, 48, n, 3)) + 1j * rng.normal(0, 5e-4, (2, 48, n, 3))
    displacement, rotation = noise.astype(np.complex64)
    run = Run.create(tmp_path / "run", moving_run.dataset, "modal", {})
    run.save_space(moving_run.load_space(), {})
    fps, n_timesteps = moving_run.load_motion().fps, moving_run.load_motion().n_timesteps
    run.save_motion(
        ModalMotion.of_phasors(np.linspace(0.2, 14, 48), displacement, rotation, fps, n_timesteps), {}
    )
    page = opened(browser, export_html(run, tmp_path / "many.html"), "#paused")
    assert page.evaluate("() => tg4mm.scene.layout.n_fields") == 96
    assert psnr(picture(page, camera, alpha=10, time=7.3), ours(run, camera, 7.3, 10)) >= LEAST_DB
    page.close()


def test_a_browser_without_webgl2_shows_why_nothing_plays(browser, page_file):
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    page = context.new_page()
    page.goto(page_file.resolve().as_uri())
    page.evaluate("() => tg4mm.ready.then(() => true, () => false)")
    assert "this browser has no WebGL 2" in page.locator("#notice").inner_text()
    context.close()


def test_a_damaged_page_says_so(browser, page_file, tmp_path):
    text = page_file.read_text(encoding="utf-8")
    scene = json.loads(text.split('id="scene">')[1].split("</script>")[0])
    scene["layout"]["n_gaussians"] += 1
    start = text.index('id="scene">') + len('id="scene">')
    damaged = tmp_path / "damaged.html"
    damaged.write_text(
        text[:start] + json.dumps(scene) + text[text.index("</script>", start) :], encoding="utf-8"
    )
    page = opened(browser, damaged)
    assert "bytes, expected" in page.locator("#notice").inner_text()
    page.close()
