"""A splat file rendered like a run: its Gaussians and modes, without data of a training."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from tg4mm.core.errors import RunError
from tg4mm.core.splatfile import SplatFile, read_splat
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run.folder import Run

LOW_PASS_PX2 = 0.3  # widening of drawn Gaussians in training, square pixels


class SplatRun(Run):
    """A run that is a splat file, without a dataset, cameras and log."""

    _stated: tuple[tuple[float, ...], float] = ((), 30.0)  # frequencies and fps, Hz

    @classmethod
    def open(cls, path: Path | str, freqs_hz: Sequence[float] = (), fps: float = 30.0) -> "SplatRun":
        """Read a splat file; `freqs_hz` and `fps` as in `read_splat`. Raises SplatFileError for another file."""
        run = cls(Path(path), {"preset": "modal", "settings": {}, "dataset": None})
        run._stated = (tuple(freqs_hz), fps)
        _ = run.splat
        return run

    @cached_property
    def splat(self) -> SplatFile:
        """Return the splat file."""
        return read_splat(self.path, *self._stated)

    @property
    def low_pass_px2(self) -> float:
        """Return the low-pass still to add when drawing, square pixels, given what the file's scales include."""
        return max(0.0, LOW_PASS_PX2 - (self.splat.low_pass_px2 or 0.0))

    @property
    def dataset(self) -> Path:
        """No folder, since a splat file does not state its origin."""
        return self.path

    @property
    def has_space(self) -> bool:
        """A splat file is a scene at rest."""
        return True

    @property
    def has_motion(self) -> bool:
        """Return whether the file has modes."""
        return self.splat.n_modes > 0

    def load_space(self) -> Gaussians:
        """Return the Gaussians at rest, float32 on the CPU."""
        splat = self.splat
        arrays = (splat.means, splat.quats, splat.scales, splat.opacities, splat.sh)
        return Gaussians(*(torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in arrays))

    def load_motion(self) -> ModalMotion | None:
        """Return the modes, or None."""
        splat = self.splat
        if not splat.n_modes:
            return None
        return ModalMotion(splat.freqs_hz, splat.displacement, splat.rotation, splat.fps, splat.n_timesteps)


def open_run(path: Path, freqs_hz: Sequence[float] = (), fps: float = 30.0) -> Run:
    """Open a run folder or splat file. Raises RunError or SplatFileError."""
    if path.is_file():
        return SplatRun.open(path, freqs_hz, fps)
    if freqs_hz:
        raise RunError(
            f"--frequencies is for a splat file with motion but without frequencies; {path} is not one"
        )
    return Run.open(path)


def cameras_asked(run: Run, given: str | None) -> None:
    """Raise RunError if a splat file should have cameras of a dataset; `given`: the option for them, if any."""
    if isinstance(run, SplatRun):
        asked = "" if given is None else f"{given}: "
        raise RunError(f"{asked}{run.path} is a splat file, which has no cameras: give --cameras FILE")
