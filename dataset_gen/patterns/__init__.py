"""Painted patterns beyond `textures`: each module is one kind of material."""
