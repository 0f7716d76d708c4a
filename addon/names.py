"""Names the extension's parts share: inputs of the modifier, attributes of the points, custom properties."""

import struct
import zlib
from collections import Counter
from collections.abc import Sequence

MODIFIER = "TG4MM"

# Inputs of the modifier. Those of motion are there only where the file has modes.
ALPHA, LOW, HIGH = "Magnification", "Band Low", "Band High"
FIRST, SPEED, LOOP = "First Frame", "Speed", "Loop"
DRAW, COLOUR_BY = "Draw As", "Colour By"
SIZE, RADIUS, MIN_OPACITY = "Size", "Ellipsoid Radius", "Minimum Opacity"
MIN_SPLAT_OPACITY = "Minimum Splat Opacity"
VIEW_COLOUR, SOLID_COLOUR = "View-Dependent Colour", "Solid View Colours"
BLEND = "Blend as Trained"
COLOUR_RANGE = "Colour Range"
ARROW_LENGTH, ARROW_EVERY = "Arrow Length", "Arrow Every"
# Items of the menu Colour By, in their order. Those of Draw As: nodes/shapes.py.
FILE_COLOUR, AMPLITUDE_COLOUR, PHASE_COLOUR = COLOUR_ITEMS = ("File", "Amplitude", "Phase")

# Attributes of the mesh's points; the node tree finds them by name.
SCALE, ROTATION, COLOUR, OPACITY, DISPLACEMENT = "scale", "rotation", "colour", "opacity", "displacement"
MODE_PREFIX = "mode_"
# Harmonics, called as Blender 5.3's own splats call them: coefficient 0 with the opacity, and each further one.
NATIVE_PREFIX, NATIVE_BASE = "radiance:", "radiance:base"
# Of the last four vertices of a mesh, which are no Gaussians (nodes/applied.py): number, 1 to 4, first place, and a
# number for the frequencies that their file has.
REFERENCE, REFERENCE_REST = "tg4mm_reference", "tg4mm_reference_rest"
REFERENCE_MODES = "tg4mm_reference_modes"

# Custom properties of the object. MARK tells our objects; the others say what the file said.
MARK, FPS, FREQUENCIES, TIMESTEPS = "tg4mm_version", "tg4mm_fps", "tg4mm_frequencies_hz", "tg4mm_timesteps"
FRAMES = "tg4mm_frames"  # of a sequence, the name of the collection that holds its frames
# what the file says its scales hold of the training's low-pass; absent if nothing
LOW_PASS = "tg4mm_low_pass_px2"
LINEAR = "tg4mm_linear"
UNIT_SCALE = "tg4mm_unit_scale_m"  # metres per scene unit; absent if unknown
NOTES = "tg4mm_notes"  # what the import has to say about the object, lines
AXES = "tg4mm_axes"  # what the import took for up, as in io/splats.py; absent: as in the file
TIME_ORIGIN = "tg4mm_time_origin_s"  # of timestep 0 on the recording's clock, s; absent: 0
MODE_AMPLITUDES = "tg4mm_mode_amplitudes"  # largest amplitude of each mode, scene units
MODE_RMS = "tg4mm_mode_rms"  # amplitude of each mode, rms over the Gaussians by opacity, scene units
MODE_AXES = "tg4mm_mode_axes"  # per mode x, y, z: the unit vector against which its phases are measured

# What the probe read last: its label, per mode re x, im x, re y … of the phasor, and the amplitude's standard deviation
# (absent if the file does not say it), scene units.
PROBE_LABEL, PROBE_PHASORS, PROBE_DEVIATIONS = (
    "tg4mm_probe_label",
    "tg4mm_probe_phasors",
    "tg4mm_probe_deviations",
)
PROBE_PLACE = "tg4mm_probe_place"  # where that was at rest, in the file's axes
PROBE_OF = "tg4mm_probe_of"  # on a sphere empty: the splat object that it was made for
CROP_OF = "tg4mm_crop_of"  # on a box empty: likewise


def modes_number(freqs_hz: Sequence[float], fps: float) -> int:
    """Return a 31-bit hash of the frequencies and the rate, to detect a file with others."""
    return zlib.crc32(struct.pack(f"<{len(freqs_hz) + 1}d", *freqs_hz, fps)) & 0x7FFFFFFF


def phasor(mode: int) -> dict[str, str]:
    """Return the names of a mode's vector attributes: real and imaginary displacement and rotation vector."""
    return {part: f"{MODE_PREFIX}{mode}_{part}" for part in ("re", "im", "re_r", "im_r")}


def amplitude(mode: int) -> str:
    """Float attribute: the largest displacement of the mode, scene units."""
    return f"{MODE_PREFIX}{mode}_amplitude"


def deviation(mode: int) -> str:
    """Float attribute: standard deviation of the mode's amplitude, scene units; only where the file says it."""
    return f"{MODE_PREFIX}{mode}_sd"


def phase(mode: int) -> str:
    """Float attribute: phase of the mode along its own direction, turns, 0 to 1."""
    return f"{MODE_PREFIX}{mode}_phase"


def native_sh(k: int) -> str:
    """Vector attribute: the red, green and blue coefficient k ≥ 1 of the spherical harmonics."""
    return f"{NATIVE_PREFIX}sh_{k - 1}"


def toggles(freqs_hz: Sequence[float]) -> list[str]:
    """Return the name of each mode's toggle input: its frequency, numbered where two are equal."""
    names = [f"{f:g} Hz" for f in freqs_hz]
    counts = Counter(names)
    seen: Counter[str] = Counter()
    for k, name in enumerate(names):
        if counts[name] > 1:
            seen[name] += 1
            names[k] = f"{name} ({seen[name]})"
    return names
