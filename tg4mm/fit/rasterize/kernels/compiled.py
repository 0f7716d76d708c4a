"""`kernel`: numba's njit with a cache on disk that a change in any file of kernels/ or simd/ invalidates.

Numba's own cache looks at the file of the function alone, but kernels take constants and helpers from other files of
these two folders: after a change there it would go on serving machine code of the old ones.

A process that finds kernels missing from the cache says so, once, to the log `tg4mm`, which the program shows.
"""

import hashlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import event

_LOG = logging.getLogger("tg4mm")
# What `parallel=True` would run on threads besides `prange`: arrays filled, sums … Each would be compiled as a kernel.
_ALONE = ("comprehension", "reduction", "inplace_binop", "setitem", "numpy", "stencil", "fusion")

# Of parts, which kernels alone call: wrappers for calls from Python would take a sixth of all compile time.
_PART = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _digest() -> str:
    """Return the digest of all files of kernels/, where this file is, and of simd/ beside it."""
    digest, package = hashlib.sha256(), Path(__file__).parents[1]
    for path in (p for folder in ("kernels", "simd") for p in sorted((package / folder).glob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_SOURCES = _digest()


class _Notice(event.Listener):
    """Log once, at the first compilation, that it takes a while."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: event.Event) -> None:
        if not self._said:
            self._said = True
            _LOG.info("compiling kernels for this processor, once: up to a minute")

    def on_end(self, event: event.Event) -> None:
        pass


event.register("numba:compile", _Notice())


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile with numba's options, divisions as numpy's, cached until any file of kernels/ or simd/ changes.

    parallel: for `prange` alone.
    """
    if options.get("parallel"):
        options["parallel"] = dict.fromkeys(_ALONE, False)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        # numba has no public way to say what a cached function depends on
        index: Any = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
        if hasattr(index, "_source_stamp"):
            index._source_stamp = (index._source_stamp, _SOURCES)
        return dispatcher

    return decorate


def part(function: Callable[..., Any]) -> Any:
    """Compile a part of kernels, which LLVM may inline."""
    return njit(**_PART)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a part of kernels, which becomes one with their code.

    By LLVM, which sees what a caller passes as constants. Numba's own `inline="always"` copies a part's Python code
    into every place it is called from and infers its types there anew: kernels take up to 1.8 times as long to compile.
    No part may have `fastmath`: its last bits would depend on what it is optimised together with, hence on whether
    this process compiled it.
    """
    return njit(forceinline=True, **_PART)(function)
