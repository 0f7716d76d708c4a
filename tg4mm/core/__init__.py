"""Shared foundations: errors, files, checked values, pictures, pages, splat files, magnification."""
