"""What an import has made so far: kept if it ends well, removed if it does not."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import bpy


class Made:
    """`with Made() as made:` removes every data-block given to `keep` if the block leaves by an exception."""

    def __init__(self) -> None:
        self._blocks: list[Any] = []

    def keep(self, block: Any) -> Any:
        """Remember a data-block that was just made; returns it."""
        self._blocks.append(block)
        return block

    def __enter__(self) -> Made:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None and self._blocks:
            bpy.data.batch_remove(self._blocks)
