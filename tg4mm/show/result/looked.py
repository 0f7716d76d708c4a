"""Vibrations that the look at a fixed camera's regions found, also those that the complete picture does not show."""

import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.look import LookLine, LookSummary, MovingRegion
from tg4mm.capture.look.rows import row_note
from tg4mm.capture.look.zoom import swing_note
from tg4mm.capture.scene import is_coded, video_file
from tg4mm.core.files import argument
from tg4mm.core.phasors import scale_top
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import CLEAR_PERIODS, fixed_cameras
from tg4mm.show.result.advice import suggested_bands
from tg4mm.show.result.model import WHY_NO_DAMPING, Length, Vibration
from tg4mm.show.result.reading import ResultSources

_MOST = 4  # independently moving regions that are listed
_WHY_NO_DAMPING = WHY_NO_DAMPING | {"untold": "it is too faint to show whether it rings down"}


def looked_vibrations(
    found: LookSummary,
    capture: Capture,
    fps: float,
    duration_s: float,
    depths: Sequence[float] | None = None,
) -> tuple[Vibration, ...]:
    """Return the vibrations without a mark, the largest amplitude first.

    depths: distance of each from the camera, along its axis; None for a flat capture, at 1.
    """
    lines = found.vibrations
    apart = list({line.hz: line for line in lines}.values())  # parts of one frequency share its band
    deviations = [line.hz_deviation for line in apart]
    reach = [max(1 / duration_s, 2 * line.hz * (line.damping or 0)) for line in apart]  # half the width: ζ f
    hz = [line.hz for line in apart]
    bands = dict(zip(hz, suggested_bands(hz, deviations, duration_s, fps, reach), strict=True))
    row = 0 if depths is None else int(fixed_cameras(capture)[0].rows[0])
    viewmat, K = capture.viewmats[row].astype(float), capture.Ks[row].astype(float)
    out = []
    for line, depth in zip(lines, depths or [1.0] * len(lines), strict=True):
        sight = np.linalg.solve(K, [*line.centre_px, 1.0]) * depth
        position = viewmat[:3, :3].T @ (sight - viewmat[:3, 3])
        made = _vibration(line, position, depth / K[0, 0], bands[line.hz])
        out.append(replace(made, position_px=line.centre_px) if depths is None else made)
    return tuple(out)


def depths_of(reading: ResultSources, found: LookSummary, capture: Capture) -> list[float]:
    """Return the median depth of the visible scene in each vibration's region, or of all of it in empty regions."""
    (frames, *_), means = fixed_cameras(capture), reading.gaussians.means.numpy()
    x = means.astype(float) @ frames.viewmat[:3, :3].T + frames.viewmat[:3, 3]
    depth = np.maximum(x[:, 2], 1e-9)
    at = np.floor(x[:, :2] / depth[:, None] * np.diag(frames.K)[:2] + frames.K[:2, 2])
    inside = (x[:, 2] > 0) & ((at >= 0) & (at < found.size)).all(1)
    column, row = np.where(inside[:, None], at, 0).astype(int).T
    seen, out = np.where(inside, reading.seen.weights, 0), []
    for line in found.vibrations:
        here = np.where(found.pixels(line.region)[row, column], seen, 0)
        out.append(float(scale_top(depth, here if here.any() else seen, 0.5)))
    return out


def _vibration(line: LookLine, position: np.ndarray, unit: float, band: tuple[float, float]) -> Vibration:
    """Return the vibration of a line; `unit` is a pixel's size in scene units."""
    pixels = Length(line.amplitude_px, line.amplitude_deviation_px, bool(line.lost))
    return Vibration(
        hz=line.hz,
        deviation_hz=line.hz_deviation,
        amplitude=pixels.times(unit),
        position=(float(position[0]), float(position[1]), float(position[2])),
        pixels=pixels,
        damping=line.damping,
        damping_deviation=line.damping_deviation,
        why_no_damping="" if line.damping is not None else _WHY_NO_DAMPING.get(line.change, "not tested"),
        band=band,
        begins_s=line.start_s,
    )


def looked_notes(found: LookSummary, is_flat: bool = True) -> list[str]:
    """Return notes on independent motion, passing objects, flicker, and lines in doubt."""
    movers = found.movers if is_flat else ()  # other fits exclude nothing
    out = [_moves(mover) for mover in movers[:_MOST]]
    if len(movers) > _MOST:
        out.append(f"{len(movers) - _MOST} more regions with independent motion or a passing object")
    out += [
        f"whether something vibrates at {line.hz:.4g} Hz ({line.amplitude_px:.2g} px at {_at(line)}): {line.mark}"
        for line in found.lines
        if line.mark
    ]
    out += [
        f"the amplitude above {line.amplitude_px:.2g} px at {line.hz:.4g} Hz at {_at(line)}: {line.lost}"
        for line in found.vibrations
        if line.lost
    ]
    if found.conversion:
        out.append(f"motion between the original pictures: {found.conversion}")
    if found.light:
        named = ", ".join(f"{tone.hz:.4g} Hz ({100 * tone.amplitude:.2g} %)" for tone in found.light)
        out.append(f"faint vibrations at the frequencies of the light: it flickers at {named}")
    for swing in found.swings:
        whose = "light" if swing.kind == "light" else "picture"
        out.append(
            f"motion of the scene from that of the camera: the {whose} {swing_note(swing, found.size)}"
        )
    return out + [note for note in [row_note(found)] if note]


def _moves(mover: MovingRegion) -> str:
    left, upper, right, lower = mover.box
    where = f"between pixels ({left}, {upper}) and ({right}, {lower})"
    if mover.kind == "passes":
        return f"motion {where} from {mover.from_s:.1f} to {mover.until_s:.1f} s, while something passes"
    rate = "" if mover.hz is None else f", periodically at {mover.hz:.4g} Hz or an alias of it"
    return f"vibration {where}: an object there moves independently{rate}, and is excluded from the fit"


def _at(line: LookLine) -> str:
    return f"({line.centre_px[0]:.0f}, {line.centre_px[1]:.0f})"


def cannot_tell(
    reading: ResultSources, motion: ModalMotion, vibrations: tuple[Vibration, ...]
) -> tuple[str, ...]:
    """Return a line for each quantity that the run cannot determine."""
    duration = reading.duration_s
    out = [*reading.log.get("notes", ())]
    if reading.look is not None and reading.capture is not None:
        out += looked_notes(reading.look, not reading.capture.kind.sees_depth)
    out.append(
        f"frequencies below {CLEAR_PERIODS / duration:.3g} Hz or from {motion.fps / 2:.4g} Hz on, and two that are "
        f"closer than {1 / duration:.3g} Hz: the record covers {duration:.3g} s at {motion.fps:.4g} Hz"
    )
    if "along_sight" in reading.uncertainty and vibrations:
        out.append(
            "motion towards the only camera: its amplitude is underestimated; the ± of lengths covers up to three "
            "times the motion across"
        )
    if "noise" not in reading.uncertainty and vibrations:
        out.append(
            f"the uncertainty of amplitudes: the preset {reading.run.preset} with these settings does not estimate it"
        )
    if vibrations and reading.capture is not None and is_coded(reading.capture.root):
        tested = f": tg4mm measure {argument(reading.run.path)} --out FOLDER tests it"
        is_tested = video_file(reading.capture.root) is not None
        out.append(
            "the loss of small amplitudes by compression of the video, which the ± does not include"
            + (tested if is_tested else "")
        )
    if reading.capture is None:
        out.append(f"pixels and the scale: the dataset {reading.run.dataset} does not exist")
    elif reading.capture.unit_scale_m is None and reading.capture.kind.sees_depth:
        out.append(
            "millimetres: unit_scale_m (metres per scene unit) in "
            f"{shlex.quote(str(reading.capture.root / 'scene.json'))} is not known"
        )
    return tuple(out)
