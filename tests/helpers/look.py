"""A look that found one line, a wheel and flicker."""

import numpy as np

from tg4mm.capture.look import FlickerLine, LookLine, LookSummary, MovingRegion


def found(mark: str = "", hz: float = 5.2) -> LookSummary:
    cells = np.zeros((3, 4), bool)
    cells[1, 2] = True
    line = LookLine(
        *(hz, 0.01, 0.12, 0.004, "decays", 0.02, 0.001, None, 0.0, (0.6, -0.8), 0.3, (40.0, 24.0)),
        *((32, 16, 48, 32), cells, cells, 80.0, None, mark),
    )
    mover = MovingRegion("moves by itself", (0, 0, 16, 16), 7.5, 0.01, 0.0, 5.0)
    by_itself = np.zeros((3, 4), bool)
    by_itself[0, 0] = True
    hz_axis = np.linspace(0, 15, 31)
    tones = (FlickerLine(10.0, 0.01, 0.02),)
    return LookSummary((line,), (mover,), tones, (), hz_axis, np.ones(31), 1.5, by_itself, 16, (64, 50))
