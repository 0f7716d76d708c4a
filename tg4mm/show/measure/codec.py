"""What the video's compression took from the peaks of sensors, where one fixed camera filmed them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt

from tg4mm.capture.codec import Tone, codec_losses
from tg4mm.capture.scene import video_file
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensor_result import SensorResult

_NEAR_PX = 4.0  # of the Gaussians of a region: a pixel that belongs to it


def with_losses(scene: Prepared, results: Sequence[SensorResult]) -> list[SensorResult]:
    """The results with what compression let through of every peak; as they are where no video is kept with the run."""
    video = video_file(scene.capture.root)
    if video is None or len(scene.observations.frames) != 1:
        return list(results)
    regions = [_region(scene, result) for result in results]
    tones = [_tones(result) for result in results]
    fps = scene.observations.fps
    found = codec_losses(video.path, regions, tones, fps, video.from_s, video.repeats)
    return [result.with_(losses=tuple(own)) for result, own in zip(results, found, strict=True)]


def _tones(result: SensorResult) -> list[Tone]:
    """Of all peaks, pixels right and down."""
    right, up = (result.labels.index(name) for name in ("right", "up"))
    return [
        Tone(p.frequency_hz, np.array([p.phasor[right], -p.phasor[up]]) * result.px_per_unit)
        for p in result.spectrum.peaks
    ]


def _region(scene: Prepared, result: SensorResult) -> np.ndarray:
    """[H, W] bool: the pixels about the Gaussians of a region."""
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
