"""Frames a second of `tg4mm view` at 768 × 768 for 50,000 Gaussians: the whole way, and what of it takes how long.

    python -m benchmarks view [--gaussians 50000] [--size 768] [--modes 3] [--repeats 30] [--run RUN] [--browser]

The whole way: pose of every Gaussian at the moment, rasterised, to bytes, JPEG, handed to the server's connection. The
steps beside it are timed apart, and the price of the other way: new splats to viser's own renderer in the browser.
--run takes the Gaussians and the motion of a run instead. --browser plays them in a headless Chromium for ten seconds,
which draws in software on the same cores, and counts the pictures that it has decoded.

Figures are medians, the smallest in brackets: on a shared machine they lie apart.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from benchmarks.common import Times, machine, times_of
from benchmarks.kernels import scene as ball
from tg4mm.core.magnification import Magnification
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animator
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.rasterize.reference import rotation_matrices
from tg4mm.run import Run
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.image import render_image
from tg4mm.show.view.app import App
from tg4mm.show.view.local_server import LocalServer, start_server, stop_server
from tg4mm.show.view.painter import Look
from tg4mm.show.view.scene import RunScene, open_scene
from tg4mm.show.view.screen import Canvas
from tg4mm.show.view.session import Clock, Session

CHROMIUM = "/usr/bin/chromium"
PLAYED = 10.0  # seconds in the browser
# Counts pictures that the page has decoded: three.js takes the address of one back when it is.
COUNT = "window.decoded = 0; const r = URL.revokeObjectURL; URL.revokeObjectURL = u => { window.decoded++; r(u); }"


def synthetic(n: int, size: int, n_modes: int) -> RunScene:
    """Gaussians of about two pixels that fill a ball, each with `n_modes` random phasors."""
    (means, quats, scales, opacities, sh), viewmat, K = ball(n, size)
    gaussians = Gaussians(*(p.detach() for p in (means, quats, scales, opacities, sh)))
    rng = np.random.default_rng(0)
    phasors = (rng.normal(size=(2, n_modes, n, 3)) * 1e-3).astype(np.complex64)
    motion = ModalMotion(np.arange(2.0, 2.0 + n_modes), phasors[0], phasors[1], 30.0, 30)
    camera = Camera("ball", viewmat.numpy().astype(float), K.numpy().astype(float), size, size)
    return RunScene(Path("ball"), gaussians, motion, np.ones(n), None, (camera,), "scene units", 1.0)


def canvas(camera: Camera, size: int) -> Canvas:
    """A square page that looks from where the camera stands."""
    from scipy.spatial.transform import Rotation

    wxyz = Rotation.from_matrix(camera.viewmat[:3, :3].T).as_quat(scalar_first=True)
    fov = 2 * np.arctan(camera.height / 2 / camera.K[1, 1])
    return Canvas(tuple(camera.position), tuple(wxyz), float(fov), size, size)


def send_to(server: LocalServer):
    """What puts a picture on all pages: encoded, and into the server's queue."""

    def send(picture: np.ndarray, quality: int) -> None:
        server.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)

    return send


def add_splats(server: LocalServer, gaussians: Gaussians) -> None:
    """The Gaussians to viser's own renderer, as it takes them: one colour each, covariances in half precision."""
    axes = rotation_matrices(gaussians.quats) * gaussians.scales[:, None]
    rgb = (0.5 + 0.28209479 * gaussians.sh[:, 0]).clamp(0, 1)
    server.scene.add_gaussian_splats(
        "/splats",
        centers=gaussians.means.numpy(),
        covariances=(axes @ axes.transpose(1, 2)).numpy(),
        rgbs=rgb.numpy(),
        opacities=gaussians.opacities[:, None].numpy(),
    )


def report(name: str, timed: Times) -> None:
    median, least = timed.median, timed.least
    print(f"{name:46s} {median:7.1f} ms ({least:.1f})   {1e3 / median:6.1f} frames/s ({1e3 / least:.1f})")


def steps(shown: RunScene, size: int, repeats: int) -> None:
    """Print the time of the whole way and of its steps."""
    server = start_server(0)
    view = canvas(shown.cameras[0], size)
    camera, look = view.camera((size, size)), Look(Magnification.of(20.0))
    moments = iter(np.linspace(0, 1000, 100_000))
    session = Session(shown, look, Clock(shown.duration))
    pose = animator(shown.gaussians, shown.motion, packed=True)
    picture = session.painter.paint(look, 0.3, camera)
    send = send_to(server)

    def whole() -> None:
        send(session.painter.paint(look, next(moments), camera), 80)

    def splats() -> None:
        add_splats(server, pose(next(moments), 20.0, None))

    report("the whole way", times_of(whole, repeats))
    report("  pose of every Gaussian", times_of(lambda: pose(next(moments), 20.0, None), repeats))
    still = pose(0.3, 20.0, None)
    report(
        "  rasterised", times_of(lambda: render_image(still, camera.viewmat, camera.K, size, size), repeats)
    )
    report("  JPEG, to the queue", times_of(lambda: send(picture, 80), repeats))
    report("the other way: pose and splats, to the queue", times_of(splats, repeats))
    print(f"  {32 * len(shown.gaussians) / 1e6:.1f} MB a frame")
    stop_server(server)


def in_browser(shown: RunScene, size: int) -> None:
    """Print the rate of pictures in a headless Chromium, and their size as the pace has chosen it."""
    from playwright.sync_api import sync_playwright

    session = Session(shown, Look(Magnification.of(20.0)), Clock(shown.duration, playing=True))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        app = App(session, 0, Path(folder))
        chromium = play.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = chromium.new_page(viewport={"width": size + 400, "height": size})
        page.add_init_script(COUNT)
        page.goto(app.url)
        page.wait_for_function("window.decoded > 30", timeout=60_000)
        before, begun = page.evaluate("window.decoded"), time.monotonic()
        time.sleep(PLAYED)
        rate = (page.evaluate("window.decoded") - before) / (time.monotonic() - begun)
        (_, screen), *_ = app._screens.values()
        print(f"in Chromium, drawn by us: {rate:.1f} pictures/s decoded, the last of {screen.size} pixels")
        chromium.close()
        app.stop()


OPTIONS = {
    "--gaussians": 50_000, "--size": 768, "--modes": 3, "--repeats": 30, "--run": Path, "--browser": False
}  # fmt: skip


def run(options: argparse.Namespace) -> None:
    """Print the rates."""
    print(machine())
    if options.run:
        shown = open_scene(Run.open(options.run))
    else:
        shown = synthetic(options.gaussians, options.size, options.modes)
    assert shown.motion is not None
    print(
        f"{len(shown.gaussians)} Gaussians, {len(shown.motion.freqs_hz)} frequencies, {options.size}² pixels"
    )
    with torch.no_grad():
        steps(shown, options.size, options.repeats)
    if options.browser:
        in_browser(shown, options.size)
