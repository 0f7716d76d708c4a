"""Measurements: `python -m benchmarks.NAME` in a copy of the repository, each with its machine printed beside it."""
