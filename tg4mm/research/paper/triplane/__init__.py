"""The triplane representation of [TG4MM]: feature planes sampled at fixed points, and the decoder to Gaussians."""

from tg4mm.research.paper.triplane.cells import Cells, cells_of
from tg4mm.research.paper.triplane.decoder import Decoder, new_decoder
from tg4mm.research.paper.triplane.sample import sample

__all__ = ["Cells", "Decoder", "cells_of", "new_decoder", "sample"]
