"""`kernel`: numba's njit with a cache on disk that a change in any file of kernels/ or simd/ invalidates.

`shared`: a kernel whose work several threads share. They are Python's, since a kernel needs no interpreter while it
runs; with numba's own (`parallel=True`) the same machine code is compiled four times.

Numba's own cache looks at the file of the function alone, but kernels take constants and helpers from other files of
these two folders: after a change there it would go on serving machine code of the old ones.

A process that finds kernels missing from the cache says so, once, to the log `tg4mm`, which the program shows.
"""

import gc
import hashlib
import logging
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, update_wrapper
from pathlib import Path
from typing import Any, TypeVar

from numba import config, get_num_threads, njit, set_num_threads
from numba.core import event

_LOG = logging.getLogger("tg4mm")
T = TypeVar("T")
U = TypeVar("U")

# Of parts, which kernels alone call: wrappers for calls from Python would take a sixth of all compile time.
_PART = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _digest() -> str:
    """Return the digest of all files of kernels/, where this file is, and of simd/ beside it."""
    digest, package = hashlib.sha256(), Path(__file__).parents[1]
    for path in (p for folder in ("kernels", "simd") for p in sorted((package / folder).glob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_SOURCES = _digest()


class _Compilation(event.Listener):
    """Logs once, at the first compilation, that it takes a while; and lets no garbage be collected meanwhile.

    A compilation makes millions of objects and keeps nearly all: looking through them takes a tenth of its time.
    """

    def __init__(self) -> None:
        self._said, self._depth, self._collected = False, 0, False

    def on_start(self, event: event.Event) -> None:
        if not self._said:
            self._said = True
            _LOG.info("compiling kernels for this processor, once: half a minute")
        if self._depth == 0:
            self._collected = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self._collected:
            gc.enable()


event.register("numba:compile", _Compilation())


def kernel(function: Callable[..., Any]) -> Any:
    """Compile, divisions as numpy's, cached until any file of kernels/ or simd/ changes."""
    dispatcher = njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    # numba has no public way to say what a cached function depends on
    index: Any = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if hasattr(index, "_source_stamp"):
        index._source_stamp = (index._source_stamp, _SOURCES)
    return dispatcher


def shared(function: Callable[..., None]) -> Any:
    """Compile a kernel that every thread calls: its first arguments are the thread's number and how many there are.

    It is called from Python without those two. It may not depend on the order in which threads run.
    """
    dispatcher = kernel(function)

    def on_all_threads(*arguments: Any) -> None:
        workers = get_num_threads()
        others = [_pool().submit(dispatcher, k, workers, *arguments) for k in range(1, workers)]
        try:
            dispatcher(0, workers, *arguments)
        finally:
            for other in others:
                other.result()

    return update_wrapper(on_all_threads, dispatcher)


def on_each(function: Callable[[T], U], items: Iterable[T]) -> list[U]:
    """Return the function's result for each item, in order; threads share the items if each gets at least one.

    Kernels that the function calls then run on one thread. With fewer items than threads, items are processed in turn
    and threads share each kernel.
    """
    workers, each = get_num_threads(), list(items)
    if workers == 1 or len(each) < workers:
        return [function(item) for item in each]

    def some(worker: int) -> list[U]:
        set_num_threads(1)  # of this thread alone
        return [function(item) for item in each[worker::workers]]

    out: list[Any] = [None] * len(each)
    for worker, made in enumerate(_pool().map(some, range(workers))):
        out[worker::workers] = made
    return out


@lru_cache
def _pool() -> ThreadPoolExecutor:
    """The other threads. They are made when first needed, and anew in a process that was forked."""
    return ThreadPoolExecutor(config.NUMBA_NUM_THREADS, "kernel")  # type: ignore[attr-defined]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


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
