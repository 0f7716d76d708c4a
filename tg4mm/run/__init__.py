"""The run folder: what `tg4mm train` was asked for, what it has made, and where it can go on after a kill.

`folder.py` is the place to start. Reading a run's JSON files needs no torch: names are imported when asked for.
"""

from typing import TYPE_CHECKING

from tg4mm.core.extras import lazily

if TYPE_CHECKING:
    from tg4mm.run.folder import UNCERTAINTY as UNCERTAINTY
    from tg4mm.run.folder import Run as Run

__getattr__ = lazily(__name__, {"Run": "folder", "UNCERTAINTY": "folder"})
