"""Presets of training: what `--preset` names, each found by the entry point `tg4mm.methods`.

`modal` (docs/method.md) stands here. A package adds a preset by an entry point of its own that gives a `Preset`:

    [project.entry-points."tg4mm.methods"]
    mine = "my_package:MINE"
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.pictures import pictures_for, region_mask
from tg4mm.core.choices import METHODS
from tg4mm.core.errors import CaptureError, RunError, Tg4mmError
from tg4mm.core.magnification import Magnification
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.magnify import magnified_motion
from tg4mm.fit.motion.animate import animator
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.config import checked as checked_motion
from tg4mm.fit.motion.observations import fixed_cameras
from tg4mm.fit.space import RestViews, SpaceConfig, rest_views
from tg4mm.fit.space.config import checked as checked_space
from tg4mm.run import Run
from tg4mm.run.stages import look_at_capture, train_motion, train_plane, train_space

GROUP = "tg4mm.methods"

STILL_FPS = 30.0  # pictures a second of a still scene


@dataclass(frozen=True)
class Poses:
    """`at(t)`: the Gaussians at timestep t, which may be fractional."""

    at: Callable[[float], Gaussians]
    n_timesteps: int
    fps: float  # Hz


@dataclass(frozen=True)
class Preset:
    """A way to train, and how its runs are magnified.

    check: raises Tg4mmError for settings out of range, before anything is written.
    is_complete: whether all that the preset keeps beside the Gaussians and their motion is there.
    fit: what is left of the stages; called again after a kill. Raises Tg4mmError.
    poses: a run with motion, magnified by one of `methods` other than `modal`, on a device. `modal`, the decoded motion
        with its modes multiplied, is the same for every preset.
    """

    defaults: Mapping[str, Any]  # settings at their defaults, a frozen dataclass for each stage
    methods: tuple[str, ...]  # of magnification that its runs can do, the default first
    check: Callable[[Mapping[str, Any]], None]
    is_complete: Callable[[Run], bool]
    fit: Callable[[Run, Capture, Mapping[str, Any], str], None]
    poses: Callable[[Run, str, Magnification, str], Poses]


@cache
def presets() -> dict[str, Preset]:
    """Return all presets by name, `modal` first. Raises Tg4mmError for an entry point that cannot be loaded."""
    found = {"modal": MODAL}
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        try:
            preset = entry.load()
        except (ImportError, AttributeError) as error:
            raise Tg4mmError(f"preset {entry.name}: {entry.value} cannot be loaded: {error}") from None
        if not isinstance(preset, Preset):
            raise Tg4mmError(f"preset {entry.name}: {entry.value} is a {type(preset).__name__}, not a Preset")
        found.setdefault(entry.name, preset)
    return found


def preset_named(name: str) -> Preset:
    """Return the preset of a name. Raises Tg4mmError for an unknown one."""
    if name not in presets():
        raise Tg4mmError(f"preset is {name!r}, expected {' or '.join(presets())}")
    return presets()[name]


def preset_of(run: Run) -> Preset:
    """Return the preset of a run. Raises RunError if it is not installed."""
    if run.preset not in presets():
        raise RunError(
            f"{run.path} was trained with the preset {run.preset!r}, which is not installed: there are "
            f"{', '.join(presets())}"
        )
    return presets()[run.preset]


def _check(configs: Mapping[str, Any]) -> None:
    checked_space(configs["space"])
    checked_motion(configs["motion"])


def _fit(run: Run, capture: Capture, configs: Mapping[str, Any], device: str) -> None:
    images = pictures_for(capture)
    counts, moves = asked_masks(capture, configs)
    if not run.has_space and not capture.kind.sees_depth:
        train_plane(run, _masked(rest_views(capture, images), capture, counts), configs["space"], device)
    elif not run.has_space:
        views = _masked(rest_views(capture, images), capture, counts)
        train_space(run, views, capture.points, configs["space"], device)
    if capture.n_timesteps > 1:
        found = look_at_capture(run, capture, images)
        masks = [
            None if found is None or capture.kind.sees_depth else found.mask(),
            *(None if m is None else ~m for m in (counts, moves)),
        ]
        given = [mask for mask in masks if mask is not None]
        mask = np.any(given, axis=0) if given else None
        train_motion(run, capture, images, configs["motion"], device, mask, moves, found)


def asked_masks(capture: Capture, configs: Mapping[str, Any]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return [H, W] bool: what counts (space.mask) and where motion may be (motion.region) for the one fixed camera.

    None where it is not asked for. Raises CaptureError for bad masks, and where there is not one fixed camera.
    """
    texts = {"space.mask": configs["space"].mask, "motion.region": configs["motion"].region}
    fixed = fixed_cameras(capture) if any(texts.values()) else []
    if any(texts.values()) and len(fixed) != 1:
        named = next(name for name, text in texts.items() if text)
        raise CaptureError(
            f"{named} applies to one fixed camera, but {capture.root} has {len(fixed)}: give a mask with each picture "
            "(docs/conventions.md)"
        )
    size = capture.width, capture.height
    counts, moves = (region_mask(text, size) if text else None for text in texts.values())
    return counts, moves


def _masked(views: RestViews, capture: Capture, counts: np.ndarray | None) -> RestViews:
    """Return the Gaussians without those excluded in the mean picture of the fixed camera."""
    if counts is not None:
        row = int(fixed_cameras(capture)[0].rows[0])
        v = next(v for v, rows in enumerate(views.images) if row in rows)
        views.rgb[v][~counts] = np.nan
    return views


def _poses(run: Run, method: str, plan: Magnification, device: str) -> Poses:
    """Filter every Gaussian's displacement over time by the plan, for the method `linear`."""
    motion = run.load_motion()
    assert method == "linear", method
    assert motion is not None  # a run without motion is not magnified
    at = animator(run.load_space().to(device), magnified_motion(motion, plan))
    return Poses(at, motion.n_timesteps, motion.fps)


MODAL = Preset(
    defaults={"space": SpaceConfig(), "motion": MotionConfig()},
    methods=("modal", "linear"),
    check=_check,
    is_complete=lambda run: True,
    fit=_fit,
    poses=_poses,
)


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
            f"--{next(iter(plan.of_phase)).replace('_', '-')} is an option of the method phase; this is {method}"
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
