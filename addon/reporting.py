"""Error reporting of operators: one line, and CANCELLED."""

import functools
from collections.abc import Callable
from typing import Any

from tg4mm.core.errors import Tg4mmError

Execute = Callable[[Any, Any], set[str]]


def one_line(error: OSError, done: str) -> str:
    """What a person reads of an error of the system: the file, what could not be done with it, why."""
    return f"{error.filename or 'a file'}: cannot be {done}: {error.strerror or error}"


def reports(done: str = "used") -> Callable[[Execute], Execute]:
    """Of `execute`: bad input and files that cannot be `done` are reported, and nothing else is."""

    def decorate(execute: Execute) -> Execute:
        @functools.wraps(execute)
        def reported(operator: Any, context: Any) -> set[str]:
            try:
                return execute(operator, context)
            except Tg4mmError as error:
                said = str(error)
            except OSError as error:
                said = one_line(error, done)
            operator.report({"ERROR"}, said)
            return {"CANCELLED"}

        return reported

    return decorate
