"""From pictures to Gaussians at rest, their motion, and its magnification."""
