"""The motion of regions in the pictures of a fixed camera: one estimator, for cells of a grid and for drawn regions."""
