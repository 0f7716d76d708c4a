"""The methods by name, for `--methods` and `bench job`; pictures rendered by another program."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.truth_file import load_truth
from tg4mm.core.pictures.decode import image_header
from tg4mm.core.untrusted import read_npz
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import SET, files_state
from tg4mm.research.bench.methods import (
    Method,
    Pictures,
    Trained,
    control_points,
    eulerian,
    tracking,
)
from tg4mm.research.bench.methods.deformed import (
    PER_FRAME,
    Fit,
    PerFrameConfig,
    configured,
    deformed,
    tune_each,
)
from tg4mm.research.bench.methods.video import Linear2D, Phase2D
from tg4mm.research.bench.request import SCORINGS, BenchPlan, Training, settings_by_preset
from tg4mm.research.bench.scored import cameras_of, picture_name, video_of
from tg4mm.research.bench.sets import BenchSet, check_name, truth_at
from tg4mm.research.bench.truth_files import follow
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.research.evaluate.run import CEILING, STATIC

FILE, NAME = "displacement.npz", "displacement"
_NOTE = "displacements handed in: errors are over the points of points3d.ply, each with the same weight"
_PNG = b"\x89PNG\r\n\x1a\n"
TRACKING = tracking.NAME
_TG4MM = "the method of TG4MM, the paper that this program implements"
_TRACKING = tracking.TrackingConfig()
DEFAULT = ("modal", "paper-tuned", TRACKING, Phase2D.name)


def submitted(folder: Path, data: BenchSet) -> dict[str, Any]:
    """Return figures of a submitted motion, like `measure`; {} if `folder` has no displacements.

    Raises BenchError for a file that is not a finite `displacement` [T, P, 3] alone, and CaptureError for a dataset
    with damaged truth.
    """
    file = folder / FILE
    if not file.is_file():
        return {}
    if not file.resolve().is_relative_to(folder.resolve()):
        raise BenchError(
            f"{file} is a link that points outside its folder, to {file.resolve()}; put the file itself there"
        )
    points = load_capture(data.root).points
    if points is None:
        raise BenchError(f"{file}: dataset {data.root} has no points3d.ply that displacements could be of")
    series = _read(file, (data.n_timesteps, len(points.xyz), 3))
    truth = load_truth(data.root, data.fps, data.n_timesteps)
    found = follow(truth, np.asarray(points.xyz, np.float64))
    true = _motion(found.phasors, truth.freqs_hz, data, truth.gains)
    at_once = np.eye(data.n_timesteps, dtype=complex)  # a mode for each timestep
    figures = displacement_figures(
        _motion(series, np.zeros(len(series)), data, at_once), true, np.ones(len(points.xyz))
    )
    return {
        "log": {}, "seconds": dict.fromkeys(("space", "motion", "total")), "rows": {}, "displacement": figures,
        "n_gaussians": None, "mib_on_disk": None, "absent": {}, "notes": [_NOTE],
    }  # fmt: skip


def _read(file: Path, shape: tuple[int, ...]) -> np.ndarray:
    try:
        arrays = read_npz(file)
    except (OSError, ValueError) as error:
        raise BenchError(f"{file} is damaged or not an .npz of plain arrays: {error}") from None
    if set(arrays) != {NAME}:
        raise BenchError(f"{file} holds {', '.join(sorted(arrays)) or 'nothing'}; expected {NAME} alone")
    series = arrays[NAME]
    if series.shape != shape:
        raise BenchError(
            f"{file}: {NAME} has shape {series.shape}, expected {shape}: timesteps, points, axes"
        )
    if not np.issubdtype(series.dtype, np.floating) or not np.isfinite(series).all():
        raise BenchError(f"{file}: {NAME} has type {series.dtype}, expected finite floating-point numbers")
    return series.astype(np.float64)


def _motion(
    phasors: np.ndarray, freqs_hz: np.ndarray, data: BenchSet, gains: np.ndarray | None
) -> ModalMotion:
    still = np.zeros_like(phasors)
    return ModalMotion.of_phasors(freqs_hz, phasors, still, data.fps, data.n_timesteps, gains)


@dataclass(frozen=True)
class External:
    """Pictures in `folder`/<dataset's name>/, in the dataset's layout, or displacements: docs/protocol.md."""

    name: str
    folder: Path

    @property
    def rows(self) -> tuple[str, ...]:
        return (self.name,)

    def fit(self, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        folder = self.folder / data.label
        if not folder.is_dir():
            raise BenchError(
                f"--external {self.name}: {folder} does not exist; expected a folder with the dataset's name"
            )
        figures = submitted(folder, data)
        if not figures and not self.has_pictures(data):
            first = self.place(data, min(data.alphas)) / "000" / "test" / "r_000.png"
            raise BenchError(
                f"--external {self.name}: {folder} holds no pictures such as {first}, and no {FILE}"
            )
        return figures

    def check(self, data: BenchSet, alpha: int) -> None:
        """Raise BenchError (CaptureError) for the first picture at α that is missing, no PNG or of another size.

        Only the files' heads are read.
        """
        truth = truth_at(data, alpha)
        for i in range(len(truth)):
            path = self.folder / data.label / picture_name(truth, i)
            if not path.is_file():
                raise BenchError(
                    f"{path} does not exist: if there is any picture at an α, all pictures at that α are needed"
                )
            with path.open("rb") as file:
                if file.read(len(_PNG)) != _PNG:
                    raise BenchError(f"{path}: is no PNG file")
            head = image_header(path)
            if (head.width, head.height) != (truth.width, truth.height):
                asked = f"{truth.width}×{truth.height}"
                raise BenchError(f"{path}: is {head.width}×{head.height} pixels, expected {asked}")

    def recipe(self, row: str, data: BenchSet, place: Path, plan: BenchPlan) -> dict[str, Any]:
        folder = self.folder / data.label
        files = sorted(p for p in folder.rglob("*.png") if "test" in p.parts)
        return {"folder": str(folder.resolve()), "files": files_state(files, folder)}

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: BenchPlan
    ) -> Pictures:
        folder = self.folder / data.label
        self.check(data, int(alpha))
        for rows in cameras_of(capture):
            yield from zip(rows.tolist(), video_of(capture, rows, folder), strict=True)

    def has_pictures(self, data: BenchSet) -> bool:
        return any(self.has(data, alpha) for alpha in (0, *data.alphas))

    def has(self, data: BenchSet, alpha: float) -> bool:
        """Return whether there are pictures for this α."""
        return any(self.place(data, alpha).glob("[0-9]*/test/*.png"))

    def place(self, data: BenchSet, alpha: float) -> Path:
        """Return the parent of the timesteps' folders."""
        return self.folder / data.label / (f"magnified/x{alpha:03g}" if alpha else "")


def parse_external(given: list[str]) -> tuple[External, ...]:
    """Parse `NAME=DIR`. Raises BenchError for another form, an invalid or repeated name, and a missing folder."""
    found: dict[str, External] = {}
    for text in given:
        name, sign, folder = text.partition("=")
        if not sign or not name or not folder:
            raise BenchError(f"--external {text!r}, expected NAME=DIR")
        check_name(name, f"--external {text!r}")
        if name.lower() in map(str.lower, found):
            raise BenchError(f"--external names {name} twice")
        if not Path(folder).is_dir():
            raise BenchError(f"--external {text!r}: {folder} is not a folder")
        found[name] = External(name, Path(folder))
    return tuple(found.values())


@dataclass(frozen=True)
class Known:
    """A named method. usual: its settings; fit: moves the Gaussians of `modal`; whole: the method itself."""

    about: str
    usual: Any = None
    fit: Fit | None = None
    whole: Method | None = None


METHODS: dict[str, Known] = {
    "modal": Known("tg4mm's own; Gaussians, a few shapes of motion and their courses over time, all views at once"),
    "paper": Known(f"{_TG4MM}; magnified by `linear` or `phase`"),
    "paper-tuned": Known(f"{_TG4MM}, in minutes; by `linear` or `phase`"),
    TRACKING: Known("Gaussians moved by a deformation network, in the manner of 4DGS", _TRACKING, tracking.track),
    tracking.ALONG: Known("Gaussians and network trained together, as 4DGS does", _TRACKING, tracking.track_along),
    control_points.NAME: Known("Gaussians carried by 512 control points that an MLP moves, in the manner of SC-GS",
                               control_points.ControlConfig(), control_points.carry),
    PER_FRAME: Known("the Gaussians at rest fine-tuned to each timestep by itself", PerFrameConfig(),
                          tune_each),
    eulerian.NAME: Known("planes of density and colour at fixed points of space, after 3DMM; by `phase` or `linear`",
                         eulerian.EulerianConfig()),
    Phase2D.name: Known("phase-based magnification of each test view's own video", whole=Phase2D()),
    Linear2D.name: Known("linear Eulerian magnification of each test view's own video", whole=Linear2D()),
}  # fmt: skip
NAMES = tuple(METHODS)
_TAKEN = {*NAMES, STATIC, CEILING, SET}  # folders of rows; some file systems know no upper case


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names. Raises BenchError for an unknown or repeated name, or for none."""
    if not names or names == [""]:
        raise BenchError(f"--methods is empty, expected some of {', '.join(NAMES)}")
    for i, name in enumerate(names):
        if name not in NAMES:
            raise BenchError(f"--methods holds {name!r}, expected some of {', '.join(NAMES)}")
        if name in names[:i]:
            raise BenchError(f"--methods names {name} twice")
    return tuple(names)


def methods_of(
    names: Sequence[str], settings: Mapping[str, Mapping[str, str]], external: Sequence[External] = ()
) -> list[Method]:
    """Return the methods, in order; the first preset also has rows of its Gaussians at rest and moved exactly.

    settings: {preset or method: as `--set`}; methods that use the Gaussians of `modal` also have its settings. Raises
    BenchError for an outside method with a name of this program's.
    """
    reference = next((n for n in names if n in SCORINGS), None)
    made = [_method(n, settings, n == reference) for n in names]
    for outside in external:
        if outside.name.lower() in _TAKEN:
            raise BenchError(f"--external {outside.name}: that is the name of a row here; choose another")
    return [*made, *external]


def _method(name: str, settings: Mapping[str, Mapping[str, str]], framing: bool) -> Method:
    own, known = settings.get(name, {}), METHODS[name]
    if name in SCORINGS:
        return Trained(Training(name, name, own), framing)
    if known.fit is not None:
        return deformed(name, known.usual, known.fit, settings.get("modal", {}), own)
    return known.whole or eulerian.Eulerian(configured(name, known.usual, own))


def settings_of(given: Mapping[str, str], names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return `--set` by preset and method. Raises Tg4mmError for an unknown name, and for an invalid value."""
    usual = {n: METHODS[n].usual for n in names if METHODS[n].usual is not None}
    own = {n: {k: v for k, v in given.items() if k.startswith(f"{n}.")} for n in usual}
    for name, some in own.items():
        configured(name, usual[name], some)
    rest = {k: v for k, v in given.items() if k.partition(".")[0] not in own}
    presets = ["modal" if METHODS[n].fit else n for n in names if n in SCORINGS or METHODS[n].fit]
    return settings_by_preset(rest, list(dict.fromkeys(presets))) | own
