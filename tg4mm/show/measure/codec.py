"""Loss of the sensors' peaks by the video's compression, for one fixed camera."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt

from tg4mm.capture.codec import Loss, MeasuredTone, codec_losses
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult
from tg4mm.show.measure.spectrum import Peak

_NEAR_PX = 4.0  # from the Gaussians of a region: nearer pixels belong to it


def with_losses(scene: Prepared, results: Sequence[SensorResult]) -> list[SensorResult]:
    """Add the part of every peak that compression let through; without a video in the run nothing changes.

    Decaying peaks are also tested when they are weaker by a factor e, since the fitted decay depends on that.
    """
    video = scene.video
    if video is None or len(scene.observations.frames) != 1:
        return list(results)
    regions = [_region(scene, result) for result in results]
    fps = scene.observations.fps

    def tested(tones: list[list[MeasuredTone]]) -> list[tuple[Loss, ...]]:
        found = codec_losses(video.path, regions, tones, fps, video.from_s, video.repeats)
        return [tuple(own) for own in found]

    losses = tested([_tones(result) for result in results])
    rings = [any(_decays(p) for p in result.spectrum.peaks) for result in results]
    faded = tested([_tones(r, 1 / np.e) if own else [] for r, own in zip(results, rings, strict=True)])
    each = zip(results, losses, faded, strict=True)
    return [result.with_(losses=own, faded=weaker) for result, own, weaker in each]


def _decays(peak: Peak) -> bool:
    return peak.line is not None and peak.line.decay_per_s > 0


def _tones(result: SensorResult, of_decaying: float = 1.0) -> list[MeasuredTone]:
    """Return the tones of all peaks, pixels right and down; decaying ones are multiplied by `of_decaying`."""
    right, up = (result.labels.index(name) for name in ("right", "up"))
    flat = len(result.labels) == 2  # whose axes may be those of a tilted plane
    out = []
    for p in result.spectrum.peaks:
        scale = result.px_per_unit * (of_decaying if _decays(p) else 1.0)
        moved = (p.phasor @ result.axes)[[0, 2]] if flat else p.phasor[[right, up]]
        out.append(MeasuredTone(p.frequency_hz, moved * [1, -1] * scale))
    return out


def _region(scene: Prepared, result: SensorResult) -> np.ndarray:
    """Return the mask [H, W] of a region's pixels, or of those around its Gaussians."""
    if result.mask is not None:
        return result.mask > 0.5 * result.mask.max()
    frame, (width, height) = scene.observations.frames[0], scene.observations.size
    weights = result.body.weights
    means = scene.means[weights > 0.5 * weights.max()]
    x = means @ frame.viewmat[:3, :3].T.astype(np.float64) + frame.viewmat[:3, 3]
    at = (x[:, :2] / x[:, 2:] * np.diag(frame.K)[:2] + frame.K[:2, 2]).astype(int)
    inside = ((at >= 0) & (at < [width, height])).all(1)
    away = np.ones((height, width), bool)
    away[at[inside, 1], at[inside, 0]] = False
    if away.all():
        return ~away
    return np.asarray(distance_transform_edt(away) <= _NEAR_PX)
