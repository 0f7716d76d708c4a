"""Attenuation of the found vibrations by video compression: corrected, or reported."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tg4mm.capture.codec import LOST, Loss, MeasuredTone, before_compression, codec_losses
from tg4mm.capture.look.model import Look, LookLine


def with_losses(
    found: Look, video: Path, fps: float, start_s: float = 0.0, repeats: Sequence[int] = ()
) -> tuple[LookLine, ...]:
    """Return the lines, those without a mark corrected for compression (`codec_losses`), or marked if it made them."""
    lines = found.vibrations
    if not lines:
        return found.lines
    regions = list({line.region.tobytes(): line.region for line in lines}.values())
    by_region = [[line for line in lines if (line.region == region).all()] for region in regions]
    masks = [found.pixels(region) for region in regions]
    tones = [[_tone(line) for line in some] for some in by_region]
    all_losses = codec_losses(
        *(video, masks, tones, fps, start_s, repeats), quick=True, without_between=found.without_between
    )
    known = {
        id(line): loss
        for some, losses in zip(by_region, all_losses, strict=True)
        for line, loss in zip(some, losses, strict=True)
    }
    return tuple(
        _with_loss(line, known[id(line)], found) if id(line) in known else line for line in found.lines
    )


def _tone(line: LookLine) -> MeasuredTone:
    phasor = line.amplitude_px * np.array(line.direction) * np.exp(1j * line.phase_rad)
    return MeasuredTone(line.hz, phasor, line.decay_per_s, line.start_s or 0.0)


def _with_loss(line: LookLine, loss: Loss, found: Look) -> LookLine:
    line = _with_decay(line, loss, found)
    amplitude, deviation = before_compression(line.amplitude_px, line.amplitude_deviation_px, loss)
    is_known = bool(np.isfinite(loss.gain)) and not loss.is_made
    return replace(
        line,
        amplitude_px=amplitude,
        amplitude_deviation_px=deviation,
        kept=loss.gain if is_known else None,
        kept_deviation=loss.deviation if is_known else None,
        mark=line.mark or (loss.why if loss.is_made and loss.gain - 1 > LOST else ""),
        lost="; ".join(filter(None, ["" if loss.is_made else loss.why, line.lost])),
    )


def _with_decay(line: LookLine, loss: Loss, found: Look) -> LookLine:
    """Take from a line's damping what compression adds, or add to its deviation what that may be."""
    damping, deviation = line.damping, line.damping_deviation
    if damping is None or deviation is None:
        return line
    shown = line.decay_per_s
    if loss.is_lost:  # what is left of a steady vibration may do anything
        return replace(line, damping=None, damping_deviation=None, coded_decay_per_s=shown)
    faster, error = loss.faster or 0.0, loss.faster_deviation
    if not np.isfinite(loss.gain):
        error = found.coded_change / (found.duration_s - (line.start_s or 0.0))
    deviation = float(np.hypot(deviation, damping / shown * error))
    damping = max(damping * (1 - faster / shown), 0.0)
    return replace(line, damping=damping, damping_deviation=deviation, coded_decay_per_s=shown)
