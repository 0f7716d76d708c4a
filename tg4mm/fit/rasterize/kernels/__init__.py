"""Numba kernels of the CPU rasteriser: projection, binning into tiles, blending; forward and backward."""
