"""What `tg4mm process` says: how long it will take, and what came out."""

from pathlib import Path

from tg4mm.capture.sfm.clip import Clip, clip_frames
from tg4mm.capture.sfm.config import SfmConfig
from tg4mm.capture.sfm.sources import Sources
from tg4mm.capture.video import video_info
from tg4mm.core.choices import Kind
from tg4mm.core.pictures.decode import decode
from tg4mm.show.result.model import Length, Result, Vibration, with_deviation

# Processor seconds by measured runs: for each megapixel of all pictures (the model; then numbers, video and report),
# for each of one picture, and in any case. Model and memory: docs/results.md, "Large videos"; the rest: 301 pictures of
# 960×544 took 348 s in all, 120 of 240×160 106 s. The third dimension costs more.
_FLAT_S = 0.16 + 1.34, 25.0, 90.0
_DEEP_S = 2.0 + 1.34, 0.0, 120.0
_FLAT_GB, _DEEP_GB = 0.25, 1.7  # for each megapixel of one picture
_LEAST_GB, _MORE_GB, _ALL_MP = (
    0.6,
    1.4,
    150.0,
)  # in any case; where all pictures have so many megapixels, so much more
_NAMED = 2  # vibrations


def estimate_line(sources: Sources, config: SfmConfig) -> str:
    """About how long all steps take and how much memory, by the number of pictures, their size and the kind."""
    pictures, size = _pictures(sources, config)
    one = size[0] * size[1] / 1e6
    every = pictures * one
    has_depth = sources.sweep is not None or sources.photographs is not None or len(sources.clips) > 1
    has_depth = Kind(config.kind).sees_depth if config.kind is not None else has_depth
    of_all, of_one, always = _DEEP_S if has_depth else _FLAT_S
    seconds = of_all * every + of_one * one + always
    memory = _LEAST_GB + _MORE_GB * min(1.0, every / _ALL_MP) + (_DEEP_GB if has_depth else _FLAT_GB) * one
    what = "in 3D" if has_depth else "one fixed camera"
    return (
        f"{pictures} pictures of {size[0]}×{size[1]}, {what}: about {_about(seconds)} of processor time and "
        f"{memory:.1f} GB of memory"
    )


def _about(seconds: float) -> str:
    """To two digits at most: 90 s as 2 min."""
    minutes = seconds / 60
    if minutes < 10:
        return f"{max(1, round(minutes))} min"
    return f"{round(minutes, -1):.0f} min" if minutes < 100 else f"{minutes / 60:.1f} h"


def _pictures(sources: Sources, config: SfmConfig) -> tuple[int, tuple[int, int]]:
    """How many, and their width and height."""
    first = [*sources.clips, *sources.every()][0]
    pixels = decode(first.pictures[0]) if first.pictures else next(iter(clip_frames(first))).pixels
    return sum(_count(clip, config) for clip in sources.every()), (pixels.shape[1], pixels.shape[0])


def _count(clip: Clip, config: SfmConfig) -> int:
    if clip.pictures:
        return len(clip.pictures)
    info = video_info(clip.path)
    if not info.duration_s:
        return max(info.total, 1)
    stop = info.duration_s if config.stop_s is None else min(config.stop_s, info.duration_s)
    return max(1, round(info.total * max(stop - config.start_s, 0.0) / info.duration_s))


def result_lines(result: Result, out: Path, opens: str) -> list[str]:
    """Five lines: frequency, amplitude, where, what was not found, and what to open."""
    found = [*result.vibrations, *result.beside][:_NAMED]
    more = len(result.vibrations) + len(result.beside) - len(found)
    others = f", and {more} more" if more else ""
    lines = [
        (
            "frequency",
            f"{_each([f'{with_deviation(Length(v.hz, v.deviation_hz))} Hz' for v in found])}{others}",
        ),
        ("amplitude", _each([_size(v, result) for v in found])),
        ("where", _each([_where(v) for v in found])),
    ]
    if not found:
        nothing = "nothing vibrates" if result.n_timesteps > 1 else "a still scene: there is one timestep"
        floor = "" if result.noise_px is None else f"less than about {result.noise_px:.2g} px"
        lines = [("frequency", nothing), ("amplitude", floor or "none"), ("where", "nowhere")]
    rest = f" (and {len(result.cannot) - 1} more in the report)" if len(result.cannot) > 1 else ""
    lines += [("not found", f"{result.cannot[0]}{rest}" if result.cannot else "nothing that is known of")]
    return [*(f"{name:<11}{text}" for name, text in lines), f"{'open':<11}{out / opens}"]


def _each(texts: list[str]) -> str:
    return "; ".join(texts)


def _size(v: Vibration, result: Result) -> str:
    """Millimetres where the scale is known, else pixels."""
    if result.unit_scale_m is not None:
        millimetres = v.amplitude.times(1000 * result.unit_scale_m)
        fine = millimetres.value < 0.1
        return f"{with_deviation(millimetres.times(1000 if fine else 1))} {'µm' if fine else 'mm'}"
    return (
        f"{with_deviation(v.amplitude)} scene units" if v.pixels is None else f"{with_deviation(v.pixels)} px"
    )


def _where(v: Vibration) -> str:
    if v.place_px is not None:
        return f"pixel {v.place_px[0]:.0f}, {v.place_px[1]:.0f}"
    return f"({', '.join(f'{c:.3g}' for c in v.place)})"
