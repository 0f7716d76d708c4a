"""A method that is not part of this program, by the pictures it has rendered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.capture import Capture
from tg4mm.core.pictures.decode import image_header
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import files_state
from tg4mm.research.bench.methods import Pictures
from tg4mm.research.bench.request import Plan
from tg4mm.research.bench.scored import cameras_of, picture_name, video_of
from tg4mm.research.bench.sets import BenchSet, check_name, truth_at

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
