"""A run as files: `splat.py` a splat file with its motion, or numbered ones; `formats.py` other formats."""
