"""A flat capture's vibrations as the look at its regions found them: what the picture's whole does not show, either."""

import shlex

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.look import Found, LookLine, Mover
from tg4mm.capture.look.rows import row_note
from tg4mm.capture.look.zoom import swing_note
from tg4mm.capture.scene import is_coded, video_file
from tg4mm.core.files import argument
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import CLEAR_PERIODS
from tg4mm.show.result.advice import suggested_bands
from tg4mm.show.result.model import Length, Vibration
from tg4mm.show.result.reading import Reading

_MOST = 4  # things that move by themselves, said one by one
_WHY_NO_DAMPING = {
    "steady": "it stays as strong as it is during the record",
    "grows": "it grows during the record",
    "varies": "it gets stronger and weaker during the record",
    "untold": "it is too faint to tell whether it rings down",
}


def looked_vibrations(found: Found, capture: Capture, fps: float, duration_s: float) -> tuple[Vibration, ...]:
    """Those without a mark, the largest amplitude first."""
    lines = found.vibrations
    deviations = [line.hz_deviation for line in lines]
    reach = [max(1 / duration_s, 2 * line.hz * (line.damping or 0)) for line in lines]  # half the width: ζ f
    bands = suggested_bands([line.hz for line in lines], deviations, duration_s, fps, reach)
    return tuple(_vibration(line, capture, band) for line, band in zip(lines, bands, strict=True))


def _vibration(line: LookLine, capture: Capture, band: tuple[float, float]) -> Vibration:
    viewmat, K = capture.viewmats[0].astype(float), capture.Ks[0].astype(float)
    sight = np.array([*(np.array(line.centre_px) - K[:2, 2]) / K[[0, 1], [0, 1]], 1.0])
    place = viewmat[:3, :3].T @ (sight - viewmat[:3, 3])
    pixels = Length(line.amplitude_px, line.amplitude_deviation_px, bool(line.lost))
    return Vibration(
        hz=line.hz,
        deviation_hz=line.hz_deviation,
        amplitude=pixels.times(1 / K[0, 0]),
        place=(float(place[0]), float(place[1]), float(place[2])),
        place_px=line.centre_px,
        pixels=pixels,
        damping=line.damping,
        damping_deviation=line.damping_deviation,
        why_no_damping="" if line.damping is not None else _WHY_NO_DAMPING.get(line.change, "no test tells"),
        band=band,
        begins_s=line.start_s,
    )


def looked_notes(found: Found) -> list[str]:
    """What moves by itself or passes, what the light does, and lines that may be none of their own."""
    out = [_moves(mover) for mover in found.movers[:_MOST]]
    if len(found.movers) > _MOST:
        out.append(f"{len(found.movers) - _MOST} more places where something moves by itself or passes")
    out += [
        f"whether something vibrates at {line.hz:.4g} Hz ({line.amplitude_px:.2g} px at {_at(line)}): {line.mark}"
        for line in found.lines
        if line.mark
    ]
    out += [
        f"how much more than {line.amplitude_px:.2g} px things move at {line.hz:.4g} Hz at {_at(line)}: {line.lost}"
        for line in found.vibrations
        if line.lost
    ]
    if found.light:
        named = ", ".join(f"{tone.hz:.4g} Hz ({tone.amplitude:.2g} of it)" for tone in found.light)
        out.append(f"vibrations at the frequencies of the light: it flickers at {named}")
    for swing in found.swings:
        whose = "light" if swing.kind == "light" else "picture"
        out.append(f"motion of the scene from the camera's: the {whose} {swing_note(swing, found.size)}")
    return out + [note for note in [row_note(found)] if note]


def _moves(mover: Mover) -> str:
    left, upper, right, lower = mover.box
    where = f"between pixels ({left}, {upper}) and ({right}, {lower})"
    if mover.kind == "passes":
        return f"what is {where} while something passes, from {mover.from_s:.1f} to {mover.until_s:.1f} s"
    rate = "" if mover.hz is None else f", periodically at {mover.hz:.4g} Hz or an alias of it"
    return f"what vibrates {where}: something there moves by itself{rate}, and is left out of the fit"


def _at(line: LookLine) -> str:
    return f"({line.centre_px[0]:.0f}, {line.centre_px[1]:.0f})"


def cannot_tell(reading: Reading, motion: ModalMotion, vibrations: tuple[Vibration, ...]) -> tuple[str, ...]:
    """What the run cannot tell, a line each."""
    duration = reading.duration_s
    out = [*reading.log.get("notes", ()), *([] if reading.look is None else looked_notes(reading.look))]
    out.append(
        f"frequencies under {CLEAR_PERIODS / duration:.3g} Hz, from {motion.fps / 2:.4g} Hz on, and two that are "
        f"nearer than {1 / duration:.3g} Hz: the record covers {duration:.3g} s at {motion.fps:.4g} Hz"
    )
    if "along_sight" in reading.uncertainty and vibrations:
        out.append(
            "how far things move towards the only camera: where they do, amplitudes come out too small, by more "
            "than the ± says"
        )
    if "noise" not in reading.uncertainty and vibrations:
        out.append(
            f"how sure the amplitudes are: the preset {reading.run.preset} with these settings does not say it"
        )
    if vibrations and reading.capture is not None and is_coded(reading.capture.root):
        tested = f": tg4mm measure {argument(reading.run.path)} --out FOLDER tests it"
        is_tested = video_file(reading.capture.root) is not None
        out.append(
            "what the video's compression took of small amplitudes, which the ± does not hold"
            + (tested if is_tested else "")
        )
    if reading.capture is None:
        out.append(f"pixels and the scale: the dataset {reading.run.dataset} is not there")
    elif reading.capture.unit_scale_m is None and reading.capture.kind.sees_depth:
        out.append(
            "millimetres: unit_scale_m (metres per scene unit) in "
            f"{shlex.quote(str(reading.capture.root / 'scene.json'))} is not known"
        )
    return tuple(out)
