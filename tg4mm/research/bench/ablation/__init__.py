"""Ablations: what they vary, the datasets that they need, and their tables."""
