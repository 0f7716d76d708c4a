"""The magnified Gaussians of a run over time, whatever the method: what is rendered, scored and exported."""

from tg4mm.core.choices import METHODS
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.magnification import Magnification
from tg4mm.fit.motion.animate import animator
from tg4mm.run import Run
from tg4mm.run.preset import Poses, preset_of

STILL_FPS = 30.0  # pictures a second of a scene that has no time of its own


def method_of(run: Run, plan: Magnification) -> str:
    """The method asked for, or the run's own.

    Raises Tg4mmError for one that the run's preset cannot do, and for a filter where the method has none.
    """
    methods = preset_of(run).methods
    method = plan.method or methods[0]
    if method not in METHODS:
        raise Tg4mmError(f"method is {method!r}, expected {', '.join(METHODS)}")
    if method not in methods:
        raise Tg4mmError(
            f"--method {method}: {run.path} was trained with the preset {run.preset}, which has no feature planes; "
            f"there are {' and '.join(methods)}"
        )
    if method == "modal" and plan.filter is not None:
        raise Tg4mmError(
            f"--filter {plan.filter.kind}: the method modal picks modes by their frequency; filters belong to "
            "linear and phase"
        )
    if method != "phase" and plan.of_phase:
        raise Tg4mmError(
            f"--{next(iter(plan.of_phase)).replace('_', '-')} is of the method phase, and this is {method}"
        )
    return method


def poses_of(run: Run, plan: Magnification, device: str = "cpu") -> Poses:
    """The run's Gaussians on `device`, magnified as planned.

    Raises Tg4mmError (RunError, CaptureError) for a plan that does not fit the run: a method its preset cannot do,
    bands beyond the frame rate or overlapping, any magnification of a run without motion.
    """
    method = method_of(run, plan)
    motion = run.load_motion()
    if motion is None:
        if not plan.is_identity:
            alpha = next((b.alpha for b in plan.bands if b.alpha), plan.everywhere)
            raise RunError(f"--alpha {alpha:g}: {run.path} has no motion, only --alpha 0 can be rendered")
        still = run.load_space().to(device)
        return Poses(lambda t: still, 1, STILL_FPS)
    if not len(motion.freqs_hz) and not plan.is_identity:
        raise RunError(
            f"{run.path} found no motion: there is nothing to magnify, only --alpha 0 can be rendered"
        )
    plan.checked(motion.fps)
    if method == "modal":
        at, alphas = animator(run.load_space().to(device), motion), plan.ideal(motion.freqs_hz)
        return Poses(lambda t: at(t, alphas), motion.n_timesteps, motion.fps)
    return preset_of(run).poses(run, method, plan, device)
