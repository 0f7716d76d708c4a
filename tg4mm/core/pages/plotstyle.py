"""How matplotlib's plots look, here and on pages. Needs nothing that is not Python's own."""

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
