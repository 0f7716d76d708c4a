"""tg4mm: 3D motion magnification with Gaussians that move.

    capture = tg4mm.load_capture("data/mic_5Hz_0_005")
    gaussians = tg4mm.fit_space(capture)
    fit = tg4mm.fit_motion(capture, gaussians)
    moved = tg4mm.animate(fit, t=8, magnification=50)
    picture = tg4mm.render(moved, tg4mm.capture_cameras(capture)[0])          # [H, W, 3] float32 in 0..1
    scene = tg4mm.prepare_fit(capture, fit)
    waveform = tg4mm.measure(scene, [tg4mm.parse_sensor("top=sphere:0,0,1.2,0.6")])["top"]
    waveform.times_s, waveform.displacement, waveform.deviation               # [T], [T, 3], [T, 3]

`__all__` lists the public names; docs/python.md describes them. A name is imported when it is first asked for, so that
`import tg4mm` needs neither torch nor numpy.
"""

import os
from typing import TYPE_CHECKING

from .core import __version__ as __version__
from .core.extras import lazily

if TYPE_CHECKING:  # `as` re-exports a name to type checkers
    from tg4mm.capture import Capture as Capture
    from tg4mm.capture import ImageStack as ImageStack
    from tg4mm.capture import load_capture as load_capture
    from tg4mm.capture import load_images as load_images
    from tg4mm.core.errors import CaptureError as CaptureError
    from tg4mm.core.errors import RunError as RunError
    from tg4mm.core.errors import SplatFileError as SplatFileError
    from tg4mm.core.errors import Tg4mmError as Tg4mmError
    from tg4mm.core.magnification import BandGain as BandGain
    from tg4mm.core.magnification import Magnification as Magnification
    from tg4mm.core.splatfile import SplatFile as SplatFile
    from tg4mm.core.splatfile import read_splat as read_splat
    from tg4mm.core.splatfile import write_splat as write_splat
    from tg4mm.fit.gaussians import Gaussians as Gaussians
    from tg4mm.fit.motion import ModalMotion as ModalMotion
    from tg4mm.fit.motion import MotionConfig as MotionConfig
    from tg4mm.fit.motion import MotionFit as MotionFit
    from tg4mm.fit.rasterize import rasterization as rasterization
    from tg4mm.fit.space import SpaceConfig as SpaceConfig
    from tg4mm.run import Run as Run
    from tg4mm.run.api import animate as animate
    from tg4mm.run.api import fit_motion as fit_motion
    from tg4mm.run.api import fit_space as fit_space
    from tg4mm.show.export.splat import to_splat as to_splat
    from tg4mm.show.measure import Measurement as Measurement
    from tg4mm.show.measure import Prepared as Prepared
    from tg4mm.show.measure import Sensor as Sensor
    from tg4mm.show.measure import SensorResult as SensorResult
    from tg4mm.show.measure import measure as measure
    from tg4mm.show.measure import parse_sensor as parse_sensor
    from tg4mm.show.measure import prepare as prepare
    from tg4mm.show.measure import prepare_fit as prepare_fit
    from tg4mm.show.render.cameras import Camera as Camera
    from tg4mm.show.render.cameras import capture_cameras as capture_cameras
    from tg4mm.show.render.cameras import orbit as orbit
    from tg4mm.show.render.image import render as render

# Waiting threads of OpenMP and OpenBLAS spin by default, which on a busy machine costs ten times what it saves. Read
# when torch, numba or numpy load them, so it is set before; a value of the user's own stays.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")  # 2^4 cycles, the least; by default 2^26

# The public names and the modules they lie in, the same as above.
_PUBLIC = {
    "BandGain": "core.magnification",
    "Camera": "show.render.cameras",
    "Capture": "capture",
    "CaptureError": "core.errors",
    "Gaussians": "fit.gaussians",
    "ImageStack": "capture",
    "Magnification": "core.magnification",
    "Measurement": "show.measure",
    "ModalMotion": "fit.motion",
    "MotionConfig": "fit.motion",
    "MotionFit": "fit.motion",
    "Prepared": "show.measure",
    "Run": "run",
    "RunError": "core.errors",
    "Sensor": "show.measure",
    "SensorResult": "show.measure",
    "SpaceConfig": "fit.space",
    "SplatFile": "core.splatfile",
    "SplatFileError": "core.errors",
    "Tg4mmError": "core.errors",
    "animate": "run.api",
    "capture_cameras": "show.render.cameras",
    "fit_motion": "run.api",
    "fit_space": "run.api",
    "load_capture": "capture",
    "load_images": "capture",
    "measure": "show.measure",
    "orbit": "show.render.cameras",
    "parse_sensor": "show.measure",
    "prepare": "show.measure",
    "prepare_fit": "show.measure",
    "rasterization": "fit.rasterize",
    "read_splat": "core.splatfile",
    "render": "show.render.image",
    "to_splat": "show.export.splat",
    "write_splat": "core.splatfile",
}
__all__ = sorted(_PUBLIC)

__getattr__ = lazily(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
