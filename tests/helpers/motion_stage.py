"""A motion stage that is killed after some of its parts."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.helpers.space_train import Killed
from tg4mm.motion.checkpoints import Arrays
from tg4mm.stages.motion import StoredParts

NEVER = -1


def stop_after(count: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """From now on the process dies once so many parts have been saved; gets the names of what is computed."""
    computed: list[str] = []
    real = StoredParts.__call__

    def killed(self: StoredParts, name: str, compute: Callable[[], Arrays]) -> Arrays:
        found = real(self, name, lambda: computed.append(name) or compute())
        if len(computed) == count:
            raise Killed
        return found

    monkeypatch.setattr(StoredParts, "__call__", killed)
    return computed
