"""What the panels show, per session: which amplitude the spectrum draws, and the legend in the view."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, PointerProperty


class TG4MM_view(bpy.types.PropertyGroup):
    """Kept on the window manager, in no file"""

    measure: EnumProperty(  # type: ignore[valid-type]
        name="Amplitude",
        description="What a bar of the spectrum shows, over all Gaussians",
        items=[
            ("RMS", "RMS", "Root mean square of the Gaussians' amplitudes, weighted by opacity"),
            ("PEAK", "Largest", "Amplitude of the Gaussian that moves most"),
        ],
    )
    legend: BoolProperty(  # type: ignore[valid-type]
        name="Legend in the View",
        description="Show what the colours mean in the lower left corner of the 3D view, with its overlays",
        default=True,
    )


def of(context: Any) -> Any:
    """The settings of the session."""
    return context.window_manager.tg4mm_view


def register() -> None:
    bpy.utils.register_class(TG4MM_view)
    bpy.types.WindowManager.tg4mm_view = PointerProperty(type=TG4MM_view)


def unregister() -> None:
    del bpy.types.WindowManager.tg4mm_view
    bpy.utils.unregister_class(TG4MM_view)
