"""The stages as functions on objects in memory, which write no files (docs/python.md)."""

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.pictures import FilePictures, pictures_for
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.magnification import Magnification
from tg4mm.core.values import Number, require
from tg4mm.fit.device import check_device
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import animate as motion_animate
from tg4mm.fit.motion import pipeline
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.modes import MotionFit
from tg4mm.fit.motion.observations import observe, window_on
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.plane import fit_plane
from tg4mm.fit.space.targets import rest_views
from tg4mm.fit.space.train import fit_space as fit_views

Images = ImageStack | FilePictures


def fit_space(
    capture: Capture, config: SpaceConfig | None = None, device: str = "cpu", images: Images | None = None
) -> Gaussians:
    """Fit the static Gaussians of a capture: the scene at rest ([3DGS]; [TG4MM] Eq. (16)).

    They are fitted to the mean over time of each fixed camera's pictures.

    Args:
        capture: of any kind, also of one timestep.
        config: settings; `None`: the defaults, which follow from the data.
        device: "cpu", or "cuda", which needs gsplat.
        images: the capture's pictures if they are read already (`load_images`); `None` reads them.

    Returns:
        N Gaussians on the CPU, float32, scene units. For a flat capture (one fixed camera and nothing else) they are
        discs at distance 1 in front of it.

    Raises:
        Tg4mmError: a setting is out of range, or the device is not available.
        CaptureError: a picture cannot be read, or there is nothing to start from.
    """
    check_device(device)
    views = rest_views(capture, images or pictures_for(capture))
    fit = (
        fit_views(views, capture.points, config, device)
        if capture.kind.sees_depth
        else fit_plane(views, config, device)
    )
    return fit.gaussians


def fit_motion(
    capture: Capture,
    gaussians: Gaussians,
    config: MotionConfig | None = None,
    device: str = "cpu",
    images: Images | None = None,
) -> MotionFit:
    """Fit the motion of `gaussians` as modes: for each frequency a complex displacement and rotation (docs/method.md).

    Args:
        capture: of more than one timestep.
        gaussians: at rest, on the CPU, as `fit_space` returns them.
        config: settings; `None`: the defaults.
        device: "cpu", or "cuda", which needs gsplat.
        images: the capture's pictures if they are read already (`load_images`); `None` reads them.

    Returns:
        `gaussians` at rest (refined if the motion is large), `motion` (phasors [K, N, 3], scene units and radians, at
        `freqs_hz` [K]), `uncertainty`, `figures`, and `notes`, one line for each thing that the capture cannot tell.

    Raises:
        CaptureError: too few pictures show motion.
        RunError: no camera sees a Gaussian.
        Tg4mmError: a setting is out of range, or the device is not available or has too little memory.
    """
    check_device(device)
    observations = observe(
        capture, images or pictures_for(capture), window_on(capture, config or MotionConfig())
    )
    return pipeline.fit_motion(gaussians, observations, config, device)


def animate(fit: MotionFit, t: float, magnification: float | Magnification = 0.0) -> Gaussians:
    """The Gaussians at a timestep with their motion magnified: a displacement δ becomes (1 + α) δ ([TG4MM] Eq. (9)).

    Args:
        fit: of `fit_motion`, or `Run.load_fit` of a run folder.
        t: timestep; 0 is the reference. Fractions, and times before and after the record, are allowed.
        magnification: α of all frequencies, or a `Magnification` with bands in Hz, each with its α.

    Returns:
        N Gaussians, scene units.

    Raises:
        Tg4mmError: α or t is no finite number, bands overlap, or the plan has another method or a filter.
        RunError: a band holds none of the motion's frequencies, or the motion is not known at t.
        CaptureError: a band does not satisfy 0 ≤ low < high < fps / 2.
    """
    require("t", t, Number(), Tg4mmError)
    plan = magnification
    if not isinstance(plan, Magnification):
        require("magnification", plan, Number(), Tg4mmError)
        plan = Magnification(everywhere=float(plan))
    plan.checked(fit.motion.fps)
    if plan.method not in (None, "modal") or plan.filter is not None:
        raise RunError(
            f"method {plan.method!r} with filter {plan.filter!r}: a fit of modes is magnified by the method 'modal', "
            "which has no filter"
        )
    for low, high in plan.limits:
        if not Magnification.of(0.0, (low, high)).inside(fit.motion.freqs_hz).any():
            there = ", ".join(f"{f:g}" for f in fit.motion.freqs_hz if f > 0) or "none"
            raise RunError(
                f"band ({low:g}, {high:g}) Hz holds no frequency of the motion; there are: {there}"
            )
    alphas = plan.ideal(fit.motion.freqs_hz)
    return motion_animate.animate(fit.gaussians, fit.motion, t, alphas)
