"""A motion stage that is killed after some of its steps."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.helpers.space_train import Killed
from tg4mm.fit.motion.checkpoints import Arrays
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run.stages import RunCheckpoint

NEVER = -1


def same_motion(a: ModalMotion, b: ModalMotion) -> bool:
    """To the bit."""
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("freqs_hz", "displacement", "rotation"))


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
