"""Shared foundations: errors, files, checked values, pictures, pages, splat files, magnification."""

__version__ = "0.1.0"
