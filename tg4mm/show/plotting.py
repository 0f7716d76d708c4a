"""Writes plots atomically by matplotlib without a display, in the style of the pages' charts."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from tg4mm.core.files import write_atomic
from tg4mm.core.pages.charts import STYLE


@contextmanager
def pyplot() -> Iterator[Any]:
    """Yield `matplotlib.pyplot` in the style of the pages."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        yield plt


def save(plt: Any, figure: Any, paths: Sequence[Path], dpi: int = 120) -> None:
    """Write a figure to the files, PNG or SVG by their suffixes, and close it."""
    for path in paths:
        ending = path.suffix[1:].lower()
        metadata = {"Date": None} if ending == "svg" else None
        write_atomic(path, partial(figure.savefig, format=ending, dpi=dpi, metadata=metadata))
        figure.set_layout_engine("none")  # the first file has laid it out
    plt.close(figure)
