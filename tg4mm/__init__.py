"""tg4mm: 3D motion magnification with Gaussians that move. Imports nothing heavy; see the subpackages."""

import os

__version__ = "0.1.0"

# OpenMP's waiting threads spin by default, which on a busy machine costs ten times what it saves. Read when
# torch or numba load it, so it is set before either; a value of the user's own stays.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
