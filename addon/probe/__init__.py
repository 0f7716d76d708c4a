"""The motion of a point or a region in numbers."""
