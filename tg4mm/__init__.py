"""tg4mm: 3D motion magnification with Gaussians that move. Imports nothing heavy; see the subpackages."""

__version__ = "0.1.0"
