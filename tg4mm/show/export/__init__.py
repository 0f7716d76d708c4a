"""Exports of a run: `splat.py` a splat file with its motion, or numbered ones; `formats.py` other formats."""
