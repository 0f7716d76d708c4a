"""Motion of more than a pixel: one iteration scheme for all captures.

Pictures change in proportion to motion up to about 0.7 pixels, and a mean over larger motion is blurred. Where things
move by more, the linear fit is repeated on what the motion found so far leaves: the pictures are resampled to the
positions at rest (`resampling.py`; a flat capture's by its vibrations, `whole_pixels.py`; a shaken camera's by its
rotation, `registration.py`), or, with several cameras, compared with what the moved Gaussians show (`gauss_newton.py`).
An iteration counts only if this leaves less of the pictures than before.
"""

from collections.abc import Callable
from typing import TypeVar

LEAST_FALL = 0.05  # of the misfit, or of what was gained so far: a smaller one ends the iterations
State = TypeVar("State")


def iterated(
    state: State,
    misfit: float,
    step: Callable[[State, int], tuple[State, float] | None],
    most: int,
    of_gain: bool = False,
) -> tuple[State, list[float]]:
    """Return the last state that lowered the misfit, after at most so many steps, and the misfits along the way.

    `step` returns the next state and its misfit; None if there is none. A fall of less than `LEAST_FALL` of the last
    misfit ends the iterations; with `of_gain`, of everything gained: for misfits that are mostly noise.
    """
    misfits = [misfit]
    for k in range(most):
        found = step(state, k)
        if found is None or found[1] >= misfits[-1]:
            break
        state = found[0]
        misfits.append(found[1])
        if misfits[-2] - misfits[-1] < LEAST_FALL * (misfits[0] - misfits[-1] if of_gain else misfits[-2]):
            break
    return state, misfits
