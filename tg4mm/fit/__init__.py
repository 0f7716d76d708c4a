"""Fitting: Gaussians at rest, their motion, and its magnification."""
