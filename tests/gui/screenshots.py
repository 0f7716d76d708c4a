"""The README's pictures of the extension, out of the real Blender.

    python tests/gui/screenshots.py SPLAT.ply [--low HZ --high HZ] [--alpha 50] [--draw Splats] [--out docs/images]

Imports the file by mouse, opens the tab, magnifies the band, probes what moves most, and writes blender_panel.png and
blender_amplitude.png, ellipsoids coloured by amplitude with the legend, at the frame where the motion is largest.
Needs what setup.sh built, and root. The file of the README is a run's own: `tg4mm demo`, then demo/splat.ply.
"""

import argparse
import importlib.util
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

REPO = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(REPO))

from tests.gui import looking, sidebar  # noqa: E402
from tests.gui.session import Session  # noqa: E402
from tg4mm.core.splatfile import positions_at, read_splat  # noqa: E402

SIZE = (1280, 1200)
LARGEST = 300_000  # bytes of a picture
LOOK_FROM = (-1.2, -1.5, 0.7)


def main():
    options = _options()
    splat = read_splat(options.splat)
    band = (options.low, options.high)
    shots: list[np.ndarray] = []
    with Session.start(_extension(), [options.splat], SIZE) as blender:
        blender.ask("clear")
        sidebar.import_by_menu(blender, options.splat.name)
        sidebar.open_tab(blender)
        # What follows is set, not clicked: the panels stay as the extension opens them.
        blender.run("bpy.ops.tg4mm.true_colours()")
        _aim(blender, splat)
        if splat.n_modes:
            blender.ask("put", to="Band Low", value=options.low)
            blender.ask("put", to="Band High", value=options.high)
        blender.ask("put", to="Draw As", value=options.draw)
        blender.ask("shading", kind="MATERIAL")
        blender.run(f"bpy.context.scene.frame_set({1 + _largest(splat, options.alpha, band)})")
        shots.append(_take(blender, blender.folder / "rest.png"))
        blender.ask("put", to="Magnification", value=options.alpha)
        if splat.n_modes:
            _probe(blender, splat)
        shots.append(_take(blender, options.out / "blender_panel.png"))
        if splat.n_modes:
            blender.ask("put", to="Draw As", value="Ellipsoids")
            blender.ask("put", to="Colour By", value="Amplitude")
            _take(blender, options.out / "blender_amplitude.png")
        if blender.complaints():
            sys.exit("Blender complained:\n" + "\n".join(blender.complaints()))
    if looking.changed(shots[0], shots[1]) < 0.005:
        sys.exit(f"α = 0 and α = {options.alpha:g} look alike")


def _options():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("splat", type=Path, help="splat file with motion")
    parser.add_argument("--low", type=float, default=0.0, help="lowest frequency that is magnified, Hz")
    parser.add_argument("--high", type=float, default=1e6, help="highest frequency that is magnified, Hz")
    parser.add_argument("--alpha", type=float, default=50.0)
    parser.add_argument("--draw", default="Ellipsoids", help="Ellipsoids, Splats, Points or Arrows")
    parser.add_argument("--out", type=Path, default=REPO / "docs" / "images")
    return parser.parse_args()


def _extension():
    """The zip, built by the code of `make extension`."""
    file = REPO / "addon" / "make_extension.py"
    spec = importlib.util.spec_from_file_location("make_extension", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return Path(module.build(module.stage(REPO / "build" / "extension"), REPO / "dist"))


def _aim(blender, splat):
    """Look at the middle of the opaque Gaussians from the front, and leave nothing selected: no outlines."""
    solid = splat.means[splat.opacities > 0.3]
    low, high = np.percentile(solid, (1, 99), axis=0)
    distance = 2.5 * float(np.linalg.norm(high - low) / 2)
    right = np.cross((0.0, 0.0, 1.0), LOOK_FROM)
    # The sidebar covers the right of the view, so what is looked at stands left of its middle.
    at = (low + high) / 2 + 0.09 * distance * right / np.linalg.norm(right)
    blender.ask("view", look_from=LOOK_FROM, at=at.tolist(), distance=distance)
    blender.run("[o.select_set(False) for o in bpy.context.view_layer.objects]")


def _probe(blender, splat):
    """Probe the opaque Gaussian that moves most, with the panels of motion and band open above the reading."""
    reach = np.square(np.abs(splat.displacement)).sum(axis=(0, 2)) * (splat.opacities > 0.3)
    blender.ask("probe", at=splat.means[int(np.argmax(reach))].tolist())
    sidebar.open_only(blender, 1, 2, 4)  # Motion, Band, Probe


def _largest(splat, alpha, band):
    """The timestep at which the magnified Gaussians are farthest from rest, rms."""
    if not splat.n_modes:
        return 0
    steps = range(splat.n_timesteps)
    away = [np.square(positions_at(splat, t, alpha, band) - splat.means).mean() for t in steps]
    return int(np.argmax(away))


def _take(blender, path):
    """The 3D view with the sidebar, and the timeline, in 256 colours."""
    blender.move(*blender.region("DOPESHEET_EDITOR").middle)  # no tooltip, no button lit
    time.sleep(1.0)
    picture = blender.settled(blender.folder / "whole.png")
    view, below = blender.region("VIEW_3D"), blender.region("DOPESHEET_EDITOR")
    part = picture[view.top : below.top + below.height, view.left : view.left + view.width]
    if looking.is_blank(part):
        sys.exit("the screen is blank")
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(part).quantize(256, dither=Image.Dither.NONE)
    image.save(path, optimize=True)
    if path.stat().st_size > LARGEST:
        sys.exit(f"{path} has {path.stat().st_size} bytes, more than {LARGEST}")
    print(path)
    return part


if __name__ == "__main__":
    main()
