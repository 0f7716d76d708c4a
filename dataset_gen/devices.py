"""Where Cycles renders: the processor, or the first kind of GPU that Blender finds."""

from __future__ import annotations

from typing import Any

import bpy

from .errors import GenerateError

BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")  # OptiX before CUDA: the same cards, faster


def cycles_preferences() -> Any:
    """Cycles' own settings, which list devices."""
    return bpy.context.preferences.addons["cycles"].preferences


def gpus(preferences: Any) -> dict[str, tuple[str, ...]]:
    """Names of the GPUs by back end, in the order of BACKENDS; only back ends that have one."""
    found = {}
    for backend in BACKENDS:
        try:
            devices = preferences.get_devices_for_type(backend)
        except (TypeError, ValueError, RuntimeError):  # a build without this back end
            continue
        names = tuple(device.name for device in devices or () if device.type == backend)
        if names:
            found[backend] = names
    return found


def use_device(scene: bpy.types.Scene, device: str, preferences: Any = None) -> str:
    """Chooses the device of Cycles: "cpu", "gpu", or "auto", a GPU if there is one. Returns what was taken.

    Raises GenerateError for "gpu" where Blender finds none.
    """
    preferences = preferences or cycles_preferences()
    found = gpus(preferences) if device != "cpu" else {}
    if device == "gpu" and not found:
        raise GenerateError(
            f"--device gpu: Blender finds no GPU (looked for {', '.join(BACKENDS)}); use --device cpu or auto"
        )
    scene.cycles.device = "GPU" if found else "CPU"
    if not found:
        preferences.compute_device_type = "NONE"
        return "CPU"
    backend, names = next(iter(found.items()))
    preferences.compute_device_type = backend
    for listed in preferences.devices:
        listed.use = listed.type == backend
    return f"{backend}: {', '.join(names)}"


def device_in_use(preferences: Any = None) -> str:
    """ "GPU" if `use_device` took one, else "CPU": the value of a scene's `cycles.device`."""
    return "CPU" if (preferences or cycles_preferences()).compute_device_type == "NONE" else "GPU"
