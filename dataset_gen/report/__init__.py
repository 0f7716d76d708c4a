"""The dataset's own report: what is in it, how it moves, how far in pixels, what a perfect method would score.

Everything is read from the files of the finished folder, so a report can be made again at any time:
`python -m dataset_gen.report FOLDER`. Needs jinja2, Pillow and scikit-image; neither Blender nor torch.
"""

from importlib import import_module
from pathlib import Path

from tg4mm.core.extras import install

from ..errors import GenerateError

__all__ = ["write_overview", "write_report"]


def write_report(root: Path) -> Path:
    """Writes `root`/report/: index.html (self-contained), contact_sheet.png, thumbnail.png, summary.json.

    Returns the page. What the folder lacks (test views, truth, ground truth at an α, second renders) is said
    to be absent. Raises GenerateError if a package is not installed, or for a folder that is no dataset.
    """
    return _written("write", "write_report", root)


def write_overview(parent: Path) -> Path:
    """Writes `parent`/index.html, a page of all datasets in the folder, and returns it.

    Reads what `write_report` left; a dataset without a report is listed as such. Raises GenerateError if a
    package is not installed or there is no dataset in `parent`.
    """
    return _written("overview", "write_overview", parent)


def _written(module: str, function: str, folder: Path) -> Path:
    try:
        return Path(getattr(import_module(f"{__name__}.{module}"), function)(Path(folder)))
    except ModuleNotFoundError as error:
        raise GenerateError(
            f"the report needs the package {error.name}, which this Python lacks: "
            f"{install('generate')}, then python -m dataset_gen.report FOLDER"
        ) from error
