"""The style of matplotlib plots in files and on pages. Needs the standard library only."""

from typing import Any

COLOURS = "#0072b2", "#d55e00", "#009e73"  # Okabe and Ito's, told apart by all eyes
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "svg.hashsalt": "tg4mm",
    "legend.frameon": False,
}
