"""What is asked about a kernel that numba's cache lacks, before it is compiled: whether it may be there by now."""

from collections.abc import Callable

_answers: list[Callable[[str], bool]] = []


def answer_with(answer: Callable[[str], bool]) -> None:
    """From now on `answer`, of a kernel's module.function, tells; it may wait for the kernel."""
    _answers[:] = [answer]


def may_be_there(kernel: str) -> bool:
    """Whether to look into the cache once more."""
    return any(answer(kernel) for answer in _answers)
