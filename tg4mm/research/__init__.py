"""Benchmark, evaluation, the paper's method, demo: imported by cli alone."""
