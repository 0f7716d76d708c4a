"""A motion stage that is killed after some of its steps."""

from collections.abc import Callable

import pytest

from tests.helpers.space_train import Killed
from tg4mm.fit.motion.checkpoints import Arrays
from tg4mm.run.stages.motion import RunCheckpoint

NEVER = -1


def stop_after(count: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """From now on the process dies once so many steps have been saved; gets the names of what is computed."""
    computed: list[str] = []
    real = RunCheckpoint.__call__

    def killed(self: RunCheckpoint, name: str, compute: Callable[[], Arrays]) -> Arrays:
        found = real(self, name, lambda: computed.append(name) or compute())
        if len(computed) == count:
            raise Killed
        return found

    monkeypatch.setattr(RunCheckpoint, "__call__", killed)
    return computed
