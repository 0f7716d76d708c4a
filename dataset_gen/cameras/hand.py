"""How a hand holds a camera: tremor as band-limited noise, smooth in time and the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .camera import Aim, Camera

PLACE_RMS = 0.0015  # of the distance to the scene: 1.5 mm at one metre, per axis
TURN_RMS = float(np.radians(0.1))  # per axis
_LOWEST, _HIGHEST = 0.2, 8.0  # Hz: below is drift, which the path has; above, a hand holding weight is still
_NYQUIST_SHARE = 0.4  # of the frame rate: faster tremor would jump from frame to frame
_TONES = 40


@dataclass(frozen=True, eq=False)
class Tremor:
    """Six channels of noise over time: three of place, three of turn, each with an rms of 1.

    A sum of tones at frequencies that are spread evenly over the octaves. Their amplitudes fall as 1/√f, so
    the amplitude density over frequency falls as 1/f, as that of hand-held cameras does, and fade to nothing over
    the last quarter of the band.
    """

    frequencies_hz: np.ndarray  # [6, K]
    amplitudes: np.ndarray  # [6, K]
    phases: np.ndarray  # [6, K], radians

    @classmethod
    def of(
        cls, seed: int | tuple[int, ...], fps: float, band_hz: tuple[float, float] = (_LOWEST, _HIGHEST)
    ) -> Tremor:
        """Tremor for pictures at `fps` Hz: in a band, by default up to 8 Hz, never above 0.4 of the frame rate."""
        rng = np.random.default_rng([*(seed if isinstance(seed, tuple) else (seed,)), 0x4A2D])
        highest = min(band_hz[1], _NYQUIST_SHARE * fps)
        lowest = min(band_hz[0], highest / 8.0)
        spread = (np.arange(_TONES) + rng.random((6, _TONES))) / _TONES
        frequencies = lowest * (highest / lowest) ** spread
        fade = np.clip((highest - frequencies) / (0.25 * highest), 0.0, 1.0)
        amplitudes = frequencies**-0.5 * (0.5 - 0.5 * np.cos(np.pi * fade))
        amplitudes *= np.sqrt(2.0 / (amplitudes**2).sum(1, keepdims=True))
        return cls(frequencies, amplitudes, rng.uniform(0.0, 2 * np.pi, (6, _TONES)))

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Place [3] and turn [3] at a time in seconds, dimensionless."""
        tones = np.sin(2 * np.pi * self.frequencies_hz * time_s + self.phases)
        channels = (self.amplitudes * tones).sum(1)
        return channels[:3], channels[3:]


def held(tremor: Tremor, time_s: float, index: int, aim: Aim, place: np.ndarray) -> Camera:
    """The camera that a hand holds at `place` [3] and aims at the centre."""
    moved, turn = tremor.at(time_s)
    steady = aim.look_from(index, place)
    pose = steady.camera_to_world.copy()
    pose[:3, 3] += PLACE_RMS * aim.distance * moved
    pose[:3, :3] = pose[:3, :3] @ rotation_matrix(TURN_RMS * turn)
    return replace(steady, camera_to_world=pose)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """[3, 3] of a rotation vector [3], radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
