"""Ends this process when its parent dies, even if the parent is killed."""

import ctypes
import os
import signal
import sys
import threading
import time

_VARIABLE = "TG4MM_ENDS_WITH_PARENT"
_SIGNAL_WITH_PARENT = 1  # PR_SET_PDEATHSIG


def ending_with_this() -> dict[str, str]:
    """The environment of a child that calls `end_with_parent`; the thread that starts it must wait for it."""
    return {**os.environ, _VARIABLE: "1"}


def end_with_parent() -> None:
    """Let this process get SIGTERM when its parent dies, if the parent requested it; not on Windows."""
    if os.environ.pop(_VARIABLE, "") != "1" or sys.platform == "win32":
        return
    if sys.platform == "linux":  # no thread of Python runs while Blender renders
        ctypes.CDLL(None).prctl(_SIGNAL_WITH_PARENT, signal.SIGTERM)
    else:
        threading.Thread(target=_watch, args=(os.getppid(),), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGTERM)
