"""Changes of complete pictures that are not motion of the scene: exposure and the camera's pose."""
