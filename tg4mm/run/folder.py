"""The run folder: the request of its training, the results so far, and checkpoints to resume from.

    RUN/config.json                 dataset, preset, every setting (the seed is one), versions
    RUN/space.safetensors           Gaussians at rest; written again where large motion made them sharper
    RUN/motion.safetensors          modal motion of those Gaussians; absent for a capture of one timestep
    RUN/uncertainty.safetensors     how uncertain the motion of every Gaussian is
    RUN/log.json                    figures of every stage: seconds, peak_memory_mib, psnr, …
    RUN/checkpoint_<stage>.safetensors   state of an unfinished stage
    RUN/triplane.safetensors, RUN/planes_0001.safetensors …   parts of the preset `paper`
                                    (tg4mm/research/paper/model.py)

Every file is written under a temporary name and renamed. The safetensors files carry metadata
{format, kind, version, config, digest}; complex tensors are stored as two real ones (`name#re`, `name#im`).
A splat file is opened as a run without dataset, cameras and log (`SplatRun`).
"""

import os
import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor

from tg4mm.core import __version__
from tg4mm.core.errors import RunError
from tg4mm.core.files import to_json, write_json
from tg4mm.core.options import of_file
from tg4mm.core.splatfile import SplatFile, read_splat
from tg4mm.core.values import require
from tg4mm.core.work_folder import WorkFolder
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.modes import ModalMotion, MotionFit
from tg4mm.run.checks import (
    GAUSSIANS,
    check_finite,
    check_tensors,
    check_uncertainty,
    clock_of,
    gaussians_of,
    motion_of,
    tensors_of,
)
from tg4mm.run.log import checked_log, with_figures
from tg4mm.run.tensor_file import DIGEST, read_tensors, write_tensors

UNCERTAINTY = "uncertainty"  # a part: how uncertain the motion of every Gaussian is, docs/conventions.md
FORMAT = "tg4mm"
VERSION = 1
_FORM = {"dataset": str, "dataset_from_run": str, "preset": str, "settings": dict, "versions": dict}
_STAGES = ("space", "motion", "paper")
LOW_PASS_PX2 = 0.3  # widening of drawn Gaussians in training, square pixels


@dataclass(frozen=True)
class Run:
    """One run folder, opened. Reads and writes go to disk at once; nothing is cached."""

    path: Path  # the folder
    config: dict[str, Any]  # as config.json: format, version, dataset, preset, settings, versions

    @classmethod
    def create(cls, path: Path | str, dataset: Path | str, preset: str, settings: Mapping[str, Any]) -> "Run":
        """Make the folder, or resume it if it was made for the same dataset, preset and settings.

        Raises RunError if the folder holds something else, or was made with other settings (names the first).
        """
        path, dataset = Path(path), Path(dataset).resolve()
        try:
            plain = to_json(dict(settings), "settings")
        except TypeError as error:
            raise RunError(f"a run cannot store {error}") from None
        request = {"dataset": str(dataset), "preset": preset, **plain}
        config = new_config(path, dataset, preset, plain)
        work_folder(path).claim(request, config, lambda _: request_of(path, read_config(path)))
        run = cls.open(path)
        run._drop_finished()
        return run

    @classmethod
    def open(cls, path: Path | str) -> "Run":
        """Open an existing run folder. Raises RunError for another folder, or an unreadable config.json."""
        path = Path(path)
        if not path.is_dir():
            raise RunError(f"run folder {path} does not exist")
        return cls(path, read_config(path))

    @property
    def preset(self) -> str:
        """`modal`, `paper` or `paper-tuned`."""
        return self.config["preset"]

    @property
    def settings(self) -> dict[str, Any]:
        """Return all settings of the training, as `stage.name: value`."""
        return self.config["settings"]

    @property
    def dataset(self) -> Path:
        """The dataset's folder: the recorded one, or the same relative to the run if both were moved."""
        return dataset_folder(self.path, self.config)

    @property
    def has_space(self) -> bool:
        """Return whether the scene at rest is finished."""
        return self._file("space").is_file()

    @property
    def has_motion(self) -> bool:
        """Return whether the motion is finished."""
        return self._file("motion").is_file()

    def save_space(self, gaussians: Gaussians, info: Mapping[str, Any]) -> None:
        """Write the Gaussians at rest and record `info` under the stage `space`."""
        self.record("space", info)
        self._write("space", {name: getattr(gaussians, name) for name in GAUSSIANS})

    def load_space(self) -> Gaussians:
        """Load the Gaussians at rest, float32 on the CPU. Raises RunError if absent, truncated or foreign."""
        if not self.has_space:
            raise RunError(f"{self.path} has no space.safetensors: its space stage is not finished")
        file = self._file("space")
        tensors, _ = read_tensors(file, "space", VERSION)
        check_tensors(file, tensors, GAUSSIANS)
        return gaussians_of(file, tensors)

    def save_motion(self, motion: ModalMotion, info: Mapping[str, Any]) -> None:
        """Write the motion and record `info` under the stage `motion`. Raises RunError for another N."""
        if not self.has_space:
            raise RunError(f"{self.path} has no space.safetensors, which a motion belongs to")
        self._check_motion(motion, "motion to save")
        self.record("motion", info)
        tensors = tensors_of(motion)
        self._write("motion", tensors, fps=motion.fps, n_timesteps=motion.n_timesteps)

    def load_motion(self) -> ModalMotion | None:
        """Load the motion, or None. Raises RunError if truncated, foreign, or of other Gaussians."""
        if not self.has_motion:
            return None
        file = self._file("motion")
        tensors, header = read_tensors(file, "motion", VERSION)
        motion = motion_of(file, tensors, clock_of(file, header))
        self._check_motion(motion, str(file))
        return motion

    def _check_motion(self, motion: ModalMotion, name: str) -> None:
        gaussians = self.load_space()
        n = len(gaussians)
        if motion.n_gaussians != n:
            raise RunError(
                f"{name}: a motion of {motion.n_gaussians} Gaussians, expected the {n} in {self._file('space')}"
            )
        k = len(motion.freqs_hz)
        light, sh = motion.appearance, gaussians.sh.shape
        if light is not None and not light.fits(k, sh):
            raise RunError(
                f"{name}: light has shapes {light.shapes.shape} {light.shapes.dtype} and series {light.series.shape} "
                f"{light.series.dtype}, expected [R, {n}, 1 or 4 (at most {sh[1]}), 3] float32 and "
                f"[{k}, R] complex128"
            )

    # Parts: further results of a preset, bound to this run's settings.

    def part_file(self, name: str) -> Path:
        """Return the path of the part `name` (`kind` or `kind_number`)."""
        return self._file(name)

    def has_part(self, name: str) -> bool:
        """Return whether the part `name` exists."""
        return self._file(name).is_file()

    def save_part(self, name: str, tensors: Mapping[str, Tensor], **extra: Any) -> None:
        """Write RUN/<name>.safetensors; `extra` are JSON values for its header."""
        self._write(name, tensors, **extra)

    def load_part(
        self, name: str, also: Collection[torch.dtype] = ()
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return (tensors, header) of a part: floating-point numbers of 32 or 64 bits, or of the types in `also`.

        Raises RunError if absent, torn, foreign, not finite, of other types, or of another run.
        """
        file, (kind, _, stage) = self._file(name), name.partition("_")
        if not file.is_file():
            raise RunError(f"{self.path} has no {file.name}: its training is not finished")
        tensors, header = read_tensors(file, kind, VERSION)
        if header["config"] != self._identity() or header.get("stage", "") != stage:
            raise RunError(f"{file} belongs to a run with other settings, or to another part of the run")
        check_finite(file, tensors, also)
        return tensors, header

    def load_uncertainties(self) -> dict[str, np.ndarray]:
        """Load the motion's uncertainties, by name (`check_uncertainty`); {} if there are none. Raises RunError."""
        if not self.has_part(UNCERTAINTY):
            return {}
        tensors = self.load_part(UNCERTAINTY)[0]
        check_uncertainty(self._file(UNCERTAINTY), tensors, len(self.load_space()))
        return {name: tensor.numpy() for name, tensor in tensors.items()}

    def load_uncertainty(self) -> np.ndarray | None:
        """Load the standard deviation of each Gaussian's displacement: [N] float32, scene units.

        None if the run has none. Raises RunError.
        """
        return self.load_uncertainties().get("displacement")

    def load_fit(self) -> MotionFit:
        """Load the Gaussians, their motion and its figures. Raises RunError if absent, truncated or foreign."""
        motion = self.load_motion()
        if motion is None:
            raise RunError(f"{self.path} has no motion.safetensors: its training is not finished")
        figures = self.log().get("motion", {})
        config = of_file(
            MotionConfig, self.settings.get("motion", {}), f"{self.path / 'config.json'}: motion", RunError
        )
        return MotionFit(
            self.load_space(), motion, self.load_uncertainties(), figures, figures.get("notes", []), config
        )

    def load_noise(self) -> np.ndarray | None:
        """Load the noise in `load_uncertainty`, [N] float32, by which two halves of the data differ."""
        return self.load_uncertainties().get("noise")

    def part_rows(self, name: str, tensor: str, row: int) -> np.ndarray:
        """Read one row of a tensor of a part that `load_part` has accepted, without the rest."""
        try:
            with safe_open(self._file(name), framework="numpy") as file:
                return file.get_slice(tensor)[row]
        except Exception as error:  # the package reports damage by many types
            raise RunError(f"{self._file(name)} is truncated or absent: {error}") from None

    # Continuing after a kill.

    def save_checkpoint(self, stage: str, tensors: Mapping[str, Tensor], state: Mapping[str, Any]) -> None:
        """Keep an unfinished stage, `tensors` and `state` as JSON, in place of the last one."""
        self._write(f"checkpoint_{stage}", tensors, state=to_json(dict(state), "state"))

    def load_checkpoint(self, stage: str) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Return (tensors, state) of an unfinished stage, None if there is none.

        Raises RunError if the file is torn, or was written for another dataset, preset or settings.
        """
        kind = f"checkpoint_{stage}"
        file = self._file(kind)
        if not file.is_file():
            return None
        try:
            tensors, header = read_tensors(file, "checkpoint", VERSION)
            if DIGEST not in header:
                raise RunError(f"{file} was written by another version of this program and has no digest")
            if header["config"] != self._identity() or header.get("stage") != stage:
                raise RunError(f"{file} belongs to a run with other settings, or to another stage")
            if not isinstance(header.get("state"), dict):
                raise RunError(f"{file} holds no state")
        except RunError as error:
            raise RunError(f"{error}; delete it to start the {stage} stage again") from None
        return tensors, header["state"]

    def drop_checkpoint(self, stage: str) -> None:
        """Remove the checkpoint of the unfinished stage, if any."""
        self._file(f"checkpoint_{stage}").unlink(missing_ok=True)

    def _drop_finished(self) -> None:
        """Remove checkpoints of stages with results, which a kill between both steps leaves."""
        for file in self.path.glob("checkpoint_*.safetensors"):
            stage = file.stem.removeprefix("checkpoint_")
            if self._file(stage).is_file():
                self.drop_checkpoint(stage)

    def discard(self) -> None:
        """Remove config.json and log.json of a new folder, and the folder if it is then empty."""
        for name in ("config.json", "log.json"):
            (self.path / name).unlink(missing_ok=True)
        if not any(self.path.iterdir()):
            self.path.rmdir()

    def record(self, stage: str, info: Mapping[str, Any]) -> None:
        """Add figures of a stage to log.json, by the rules of `with_figures`."""
        write_json(self.path / "log.json", with_figures(self.log(), stage, info))

    def log(self) -> dict[str, Any]:
        """Read {stage: figures}, {} before any record. Raises RunError if truncated or of another form."""
        folder = WorkFolder(self.path, "log.json")
        return checked_log(folder.read() or {}, str(self.path / folder.record))

    def _file(self, kind: str) -> Path:
        return self.path / f"{kind}.safetensors"

    def _identity(self) -> dict[str, Any]:
        return {key: self.config[key] for key in ("dataset", "preset", "settings")}

    def _write(self, name: str, tensors: Mapping[str, Tensor], **extra: Any) -> None:
        kind, _, stage = name.partition("_")
        header = {"kind": kind, "version": VERSION, "config": self._identity(), **extra}
        write_tensors(self._file(name), tensors, header | ({"stage": stage} if stage else {}))


def work_folder(path: Path | str) -> WorkFolder:
    """Return the run folder `path` as the folder of a request."""
    return WorkFolder(Path(path), "config.json")


def new_config(path: Path, dataset: Path, preset: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of config.json for the run folder `path`; `dataset` absolute, `settings` JSON values."""
    return {
        "format": FORMAT,
        "kind": "run",
        "version": VERSION,
        "dataset": str(dataset),
        "dataset_from_run": _from_run(dataset, path.resolve()),
        "preset": preset,
        "settings": dict(settings),
        "versions": _versions(),
    }


def _from_run(dataset: PurePath, path: PurePath) -> str:
    """Return the path from a run to its dataset, with / on every system; the dataset itself if there is none."""
    try:
        return os.path.relpath(dataset, path).replace(os.sep, "/")
    except ValueError:  # on Windows, for folders on different drives
        return str(dataset)


def read_config(path: Path) -> dict[str, Any]:
    """Read config.json of the run folder `path`. Raises RunError if it is missing, truncated or foreign."""
    folder = work_folder(path)
    if (config := folder.read()) is None:
        raise RunError(f"{path} is not a run folder: it has no config.json")
    file = path / folder.record
    found = config.get("format"), config.get("kind")
    if found != (FORMAT, "run"):
        raise RunError(f"{file} is not a tg4mm run: format {found[0]!r}, kind {found[1]!r}")
    if config.get("version") != VERSION:
        raise RunError(f"{file} has version {config.get('version')!r}; this program reads {VERSION}")
    for key, rule in _FORM.items():
        require(f"{file}: {key}", config.get(key), rule, RunError)
    for stage in _STAGES:
        require(f"{file}: settings of {stage}", config["settings"].get(stage, {}), dict, RunError)
    return config


def dataset_folder(path: Path, config: Mapping[str, Any]) -> Path:
    """Return the dataset of a run: the recorded folder, or the same relative to the run if both were moved."""
    absolute = Path(config["dataset"])
    try:
        beside = (path / config["dataset_from_run"]).resolve()
        return beside if beside.exists() and not absolute.exists() else absolute
    except (OSError, ValueError):  # a name too long for any folder, or with a null character
        return absolute


def request_of(path: Path, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's request (dataset, preset, settings), as `WorkFolder.claim` compares it."""
    return {"dataset": str(dataset_folder(path, config)), "preset": config["preset"], **config["settings"]}


def _versions() -> dict[str, str]:
    versions = {"tg4mm": __version__, "python": platform.python_version()}
    for name in ("torch", "numpy", "numba"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


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
        """Return the file itself, since a splat file does not state its dataset."""
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
        return ModalMotion.of_phasors(
            splat.freqs_hz, splat.displacement, splat.rotation, splat.fps, splat.n_timesteps
        )


def open_run(path: Path, freqs_hz: Sequence[float] = (), fps: float = 30.0) -> Run:
    """Open a run folder or splat file. Raises RunError or SplatFileError."""
    if path.is_file():
        return SplatRun.open(path, freqs_hz, fps)
    if freqs_hz:
        raise RunError(
            f"--frequencies is for a splat file with motion but without frequencies; {path} is not one"
        )
    return Run.open(path)


def refuse_cameras(run: Run, given: str | None) -> None:
    """Raise RunError if a splat file should have cameras of a dataset; `given`: the option for them, if any."""
    if isinstance(run, SplatRun):
        prefix = "" if given is None else f"{given}: "
        raise RunError(f"{prefix}{run.path} is a splat file, which has no cameras: give --cameras FILE")
