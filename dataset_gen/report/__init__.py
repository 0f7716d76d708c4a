"""The dataset's own report: contact sheet, statistics and warnings on one page.

Everything is read from the files of the finished folder, so a report can be made again at any time:
`python -m dataset_gen.report FOLDER`. Needs jinja2, Pillow and scikit-image; neither Blender nor torch.
"""

from pathlib import Path

from tg4mm.core.extras import install

from ..errors import GenerateError

__all__ = ["write_report"]


def write_report(root: Path) -> Path:
    """Writes `root`/report/index.html (self-contained) and contact_sheet.png, and returns the page.

    What the folder lacks (test views, truth, ground truth at an α, second renders) is said to be absent.
    Raises GenerateError if a package is not installed, or for a folder that is no dataset.
    """
    try:
        from .page import write

        return write(Path(root))
    except ModuleNotFoundError as error:
        raise GenerateError(
            f"the report needs the package {error.name}, which this Python lacks: "
            f"{install('generate')}, then python -m dataset_gen.report FOLDER"
        ) from error
