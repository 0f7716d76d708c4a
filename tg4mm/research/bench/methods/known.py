"""The methods by name, as `--methods` and `bench job` take them; pictures that another program has rendered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture import Capture
from tg4mm.core.pictures.decode import image_header
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import SET, files_state
from tg4mm.research.bench.methods import Method, Pictures, Trained
from tg4mm.research.bench.methods.tracking import NAME as TRACKING
from tg4mm.research.bench.methods.tracking import tracking
from tg4mm.research.bench.methods.video import Linear2D, Phase2D
from tg4mm.research.bench.request import SCORINGS, Plan, Training
from tg4mm.research.bench.scored import cameras_of, picture_name, video_of
from tg4mm.research.bench.sets import BenchSet, check_name, truth_at
from tg4mm.research.evaluate.run import CEILING, STATIC

_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class External:
    """Pictures in `folder`/<dataset's name>/, laid out as the dataset's own test pictures: docs/protocol.md."""

    name: str
    folder: Path

    @property
    def rows(self) -> tuple[str, ...]:
        return (self.name,)

    def fit(self, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        folder = self.folder / data.label
        if not folder.is_dir():
            raise BenchError(
                f"--external {self.name}: {folder} does not exist; expected a folder with the dataset's name"
            )
        if not any(self.has(data, alpha) for alpha in (0, *data.alphas)):
            first = self.place(data, min(data.alphas)) / "000" / "test" / "r_000.png"
            raise BenchError(f"--external {self.name}: {folder} holds no pictures such as {first}")
        return {}

    def check(self, data: BenchSet, alpha: int) -> None:
        """Raise BenchError (CaptureError) for the first picture at α that is missing, no PNG or of another size.

        By the files' heads alone.
        """
        truth = truth_at(data, alpha)
        for i in range(len(truth)):
            path = self.folder / data.label / picture_name(truth, i)
            if not path.is_file():
                raise BenchError(f"{path} does not exist: at an α that has a picture, all are needed")
            with path.open("rb") as file:
                if file.read(len(_PNG)) != _PNG:
                    raise BenchError(f"{path}: is no PNG file")
            head = image_header(path)
            if (head.width, head.height) != (truth.width, truth.height):
                asked = f"{truth.width}×{truth.height}"
                raise BenchError(f"{path}: is {head.width}×{head.height} pixels, expected {asked}")

    def recipe(self, row: str, data: BenchSet, place: Path, plan: Plan) -> dict[str, Any]:
        folder = self.folder / data.label
        files = sorted(p for p in folder.rglob("*.png") if "test" in p.parts)
        return {"folder": str(folder.resolve()), "files": files_state(files, folder)}

    def render(
        self, row: str, data: BenchSet, place: Path, capture: Capture, alpha: float, plan: Plan
    ) -> Pictures:
        folder = self.folder / data.label
        self.check(data, int(alpha))
        for rows in cameras_of(capture):
            yield from zip(rows.tolist(), video_of(capture, rows, folder), strict=True)

    def has(self, data: BenchSet, alpha: float) -> bool:
        """Whether there is anything for this α."""
        return any(self.place(data, alpha).glob("[0-9]*/test/*.png"))

    def place(self, data: BenchSet, alpha: float) -> Path:
        """Where the folders of the timesteps lie."""
        return self.folder / data.label / (f"magnified/x{alpha:03g}" if alpha else "")


def parse_external(given: list[str]) -> tuple[External, ...]:
    """From `NAME=DIR`. Raises BenchError for another form, a name that no folder can have or given twice, no folder."""
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


BASELINES = (TRACKING, Phase2D.name, Linear2D.name)
NAMES = (*SCORINGS, *BASELINES)
_TAKEN = {*NAMES, STATIC, CEILING, SET}  # folders of rows; some file systems know no upper case
ABOUT = {
    "modal": "tg4mm's own; Gaussians and a few shapes of motion with their courses over time, from all views at once",
    "paper": "the method of TG4MM, the paper that this program implements; magnified by `linear` or `phase`",
    "paper-tuned": "the method of TG4MM, the paper that this program implements, in minutes; by `linear` or `phase`",
    TRACKING: "Gaussians moved by a deformation network, in the manner of 4DGS",
    Phase2D.name: "phase-based magnification of each test view's own video, in complex sub-bands of half an octave",
    Linear2D.name: "linear Eulerian magnification of each test view's own video",
}
DEFAULT = ("modal", "paper-tuned", *BASELINES)


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names. Raises BenchError for one that is none, given twice, or for no name at all."""
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
    """The methods, in order; the first preset also gives the rows of its Gaussians at rest and moved exactly.

    settings: {preset: as `tg4mm train --set`}; tracking has those of `modal` and its own. Raises BenchError for an
    outside method that is called as one of this program's.
    """
    reference = next((n for n in names if n in SCORINGS), None)
    made = [_method(n, settings, n == reference) for n in names]
    for outside in external:
        if outside.name.lower() in _TAKEN:
            raise BenchError(f"--external {outside.name}: that is the name of a row here; choose another")
    return [*made, *external]


def _method(name: str, settings: Mapping[str, Mapping[str, str]], framing: bool) -> Method:
    if name in SCORINGS:
        return Trained(Training(name, name, settings.get(name, {})), framing)
    if name == TRACKING:
        return tracking(settings.get("modal", {}), settings.get(TRACKING, {}))
    return Phase2D() if name == Phase2D.name else Linear2D()
