"""Magnification: bands with their factors, temporal filters, and three methods that apply them."""

from tg4mm.core.choices import FILTERS
from tg4mm.core.filters import TemporalFilter
from tg4mm.core.magnification import BandGain, Magnification

__all__ = ["FILTERS", "BandGain", "Magnification", "TemporalFilter"]
