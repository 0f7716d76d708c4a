"""What changes a whole picture from frame to frame and is no motion of the scene: exposure and the camera's pose."""
