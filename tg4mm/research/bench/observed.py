"""What of a motion can be observed: Gaussians whose exact motion shows in the pictures as it should.

Water, mirrors and plain surfaces move without showing it, or show something else. So the picture's change by the exact
motion of the Gaussians (the ceiling) is compared with the ground truth's own change, pixel by pixel, and each
Gaussian gets what happens in the pixels that it makes. No estimate takes part, so the choice favours no method.
"""

import numpy as np

from tg4mm.capture import Capture, load_capture, load_images
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.scores import BACKGROUND, Candidate, render_views
from tg4mm.research.evaluate.subject import Subject
from tg4mm.show.maps import blending_weights, pixel_sums

AGREES = 0.5  # correlation of both changes from which a Gaussian's motion counts as observed
_SHIFT_PX = 1.0  # the α is taken that brings the motion nearest to it: large enough to show, small enough to be linear
_TIMES = 12  # timesteps that are looked at, at most
_STILL = 0.01  # of the largest motion: below it a Gaussian stands still


def observed_figures(subject: Subject, data: BenchSet, train: Capture) -> dict[str, float | None]:
    """Displacement error and static leak over what can be observed and what stands still, and their shares.

    `observed_share`: the part of the moving weight that is observed. Figures are None where there is no exact or
    estimated motion.
    """
    names = ("displacement_error_observed", "observed_share")
    if subject.estimated is None or subject.exact is None:
        return dict.fromkeys(names)
    weights = blending_weights(subject.gaussians, train)
    agrees = agreement(subject.gaussians, subject.exact, data)
    size = rms_motion(subject.exact)
    still = size <= _STILL * size.max(initial=0.0)
    observed = agrees >= AGREES
    moving = weights * ~still
    share = float((moving * observed).sum() / moving.sum()) if moving.sum() > 0 else None
    kept = weights * (observed | still)
    if share is None or not kept.sum() > 0:
        return dict.fromkeys(names)
    estimated = subject.estimated
    if subject.from_zero:
        estimated = estimated.selected(estimated.freqs_hz > 0)
    figures = displacement_figures(estimated, subject.exact, kept)
    return dict(zip(names, (figures["relative_error"], share), strict=True))


def agreement(gaussians: Gaussians, exact: ModalMotion, data: BenchSet) -> np.ndarray:
    """[N] correlation, over the pixels that a Gaussian makes, of its exact motion's change with the ground truth's.

    In the test cameras, at the α that brings the motion nearest to one pixel. 0 where nothing changes.
    """
    alpha = min(data.alphas, key=lambda a: abs(np.log((1 + a) * data.amplitude_px / _SHIFT_PX)))
    capture = load_capture(data.root, split="test", magnification=alpha)
    images, moved = load_images(capture), Candidate("exact", exact)
    times = looked_at(capture.n_timesteps, data.fps, data.frequency_hz)
    sums = np.zeros((len(gaussians), 3))  # made · made, made · true, true · true
    for camera in np.unique(capture.camera_ids).tolist():
        rows = np.flatnonzero(capture.camera_ids == camera)
        chosen = [int(i) for i in rows if capture.timesteps[i] in times]
        true = np.stack([images.rgb(i, background=BACKGROUND) for i in chosen])
        made = np.stack(
            [
                render_views(moved.pose(gaussians, int(capture.timesteps[i]), alpha), capture, np.array([i]))[
                    0
                ]
                for i in chosen
            ]
        )
        true, made = true - true.mean(0), made - made.mean(0)
        maps = np.stack([(made * made).sum((0, 3)), (made * true).sum((0, 3)), (true * true).sum((0, 3))], -1)
        sums += pixel_sums(gaussians, maps, capture.viewmats[chosen[0]], capture.Ks[chosen[0]])
    own, both, truth = sums.T
    norm = np.sqrt(own * truth)
    return np.divide(both, norm, out=np.zeros_like(both), where=norm > 0)


def looked_at(n_timesteps: int, fps: float, frequency_hz: float) -> list[int]:
    """Timesteps spread over the first period, or over the record where that is shorter, `_TIMES` at most.

    Spread over the whole record they could all show the same phase.
    """
    period = fps / frequency_hz if frequency_hz > 0 else n_timesteps
    last = min(n_timesteps, max(round(period), 2)) - 1
    return [int(t) for t in np.unique(np.linspace(0, last, _TIMES).round())]


def rms_motion(motion: ModalMotion) -> np.ndarray:
    """[N] rms over modes of the phasors' lengths, scene units."""
    return np.sqrt((np.abs(motion.displacement.astype(np.complex128)) ** 2).sum((0, 2)) / 2)
