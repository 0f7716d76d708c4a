"""Generators of meshes that one or more scenes are built from; each module is one kind of shape."""
