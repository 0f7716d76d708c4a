"""Motion of more than a pixel, by repeated fits."""
