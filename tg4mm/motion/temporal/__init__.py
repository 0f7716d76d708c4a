"""Frequencies, tones and drift of what changes."""
