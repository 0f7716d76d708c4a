"""Magnification: bands with their factors, temporal filters, and three methods that apply them."""

from tg4mm.magnify.bands import BandGain, Magnification
from tg4mm.magnify.filters import FILTERS, TemporalFilter

__all__ = ["FILTERS", "BandGain", "Magnification", "TemporalFilter"]
