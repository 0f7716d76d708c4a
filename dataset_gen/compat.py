"""Differences between Blender 4.5 and 5.2; where Cycles renders: the processor or the first kind of GPU."""

from typing import Any

import bpy

from .errors import GenerateError

BACKENDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")  # OptiX before CUDA: the same cards, faster


def is_5() -> bool:
    """Return whether this is Blender 5.0 or later."""
    return bool(bpy.app.version >= (5, 0, 0))


def version() -> str:
    """Blender's version as numbers, "4.5.15"."""
    return ".".join(str(n) for n in bpy.app.version)


def eevee() -> str:
    """The engine's name."""
    return "BLENDER_EEVEE" if is_5() else "BLENDER_EEVEE_NEXT"


def set_float_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """32-bit RGBA EXR, not compressed: it is read back at once."""
    if is_5():
        settings.media_type = "IMAGE"
    settings.file_format = "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"


def set_multilayer_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """32-bit multilayer EXR in one part."""
    if is_5():
        settings.media_type = "MULTI_LAYER_IMAGE"
        settings.use_exr_interleave = True
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"


def use_physical_sky(node: bpy.types.ShaderNodeTexSky) -> None:
    """The sky model of single scattering with a sun disc, called Nishita before 5.0."""
    node.sky_type = "SINGLE_SCATTERING" if is_5() else "NISHITA"
    node.sun_disc = True


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
