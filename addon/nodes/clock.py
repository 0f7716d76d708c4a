"""Where in its recording a splat object is: the same time as in its node tree (nodes/motion.py, `elapsed`)."""

from __future__ import annotations

from typing import Any

from .. import compat, names

FEWEST_FRAMES = 4.0  # of a period: with fewer, a vibration does not look like one


def rate(scene: Any) -> float:
    """The scene's frames per second."""
    return float(scene.render.fps / scene.render.fps_base)


def timestep(scene: Any, obj: Any, modifier: Any) -> float:
    """Timesteps since the first frame at the current frame, fractions included."""
    first, speed = (compat.get_number(modifier, name) for name in (names.FIRST, names.SPEED))
    fps = float(obj[names.FPS])
    return (scene.frame_current_final - first) * speed * (fps / rate(scene) if fps else 1.0)


def lines(scene: Any, obj: Any, modifier: Any) -> list[str]:
    """What the panel says: the time, how fast it passes, and whether the frames are too few to show it."""
    fps, steps = float(obj[names.FPS]), int(obj[names.TIMESTEPS])
    if not fps:
        return []
    now, speed = timestep(scene, obj, modifier) / fps, compat.get_number(modifier, names.SPEED)
    said = [f"{now:.3f} s of {steps / fps:.3f} s, {pace(speed)}"]
    low, high = (compat.get_number(modifier, name) for name in (names.LOW, names.HIGH))
    inside = [float(f) for f in obj[names.FREQUENCIES] if low <= f <= high]
    fastest = max(inside, default=0.0)
    if fastest * abs(speed) * FEWEST_FRAMES > rate(scene):
        said.append(f"{rate(scene) / (fastest * abs(speed)):.1f} frames a period at {fastest:.4g} Hz")
        said.append("Too few to see it: lower Speed")
    return said


def not_finite(modifier: Any) -> list[str]:
    """A line for each number of the modifier that is NaN or infinite, which a driver or a script can make it."""
    shown = [name for name in (names.ALPHA, names.SPEED, names.FIRST) if compat.has_input(modifier, name)]
    values = {name: float(compat.get_input(modifier, name)) for name in shown}
    return [
        f"{name} is {value:g}: plays as 0" for name, value in values.items() if not compat.is_number(value)
    ]


def pace(speed: float) -> str:
    """A speed in words: "real time", "10 × slower"."""
    if speed in (0.0, 1.0):
        return "real time" if speed else "stopped"
    way = "" if speed > 0 else "backwards, "
    size = abs(speed)
    if size == 1:
        return "backwards"
    return way + (f"{1 / size:.4g} × slower" if size < 1 else f"{size:.4g} × faster")
