"""Measurements: `python -m benchmarks NAME` in a copy of the repository."""
