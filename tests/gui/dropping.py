"""Runs inside the chroot: drags a file onto a window as a file manager does, by the XDND protocol, version 5.

    python3 dropping.py WINDOW X Y FILE        X, Y: pixels of the screen; ends with status 1 if it is not taken

xdotool cannot: the file's address is handed over between two programs, window to window.
"""

import ctypes
import struct
import sys
import time
from pathlib import Path
from typing import Any

CLIENT_MESSAGE, SELECTION_REQUEST, SELECTION_NOTIFY = 33, 30, 31
VERSION, PATIENCE_S = 5, 60.0
EVENT = 192  # bytes of an XEvent

X: Any = ctypes.CDLL("libX11.so.6")
for name, result, arguments in (
    ("XOpenDisplay", ctypes.c_void_p, [ctypes.c_char_p]),
    ("XDefaultRootWindow", ctypes.c_ulong, [ctypes.c_void_p]),
    ("XInternAtom", ctypes.c_ulong, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]),
    ("XCreateSimpleWindow", ctypes.c_ulong, [ctypes.c_void_p, ctypes.c_ulong, *[ctypes.c_int] * 2,
                                             *[ctypes.c_uint] * 3, *[ctypes.c_ulong] * 2]),
    ("XSetSelectionOwner", ctypes.c_int, [ctypes.c_void_p, *[ctypes.c_ulong] * 3]),
    ("XSendEvent", ctypes.c_int, [ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int, ctypes.c_long, ctypes.c_char_p]),
    ("XChangeProperty", ctypes.c_int, [ctypes.c_void_p, *[ctypes.c_ulong] * 3, *[ctypes.c_int] * 2,
                                       ctypes.c_char_p, ctypes.c_int]),
    ("XPending", ctypes.c_int, [ctypes.c_void_p]),
    ("XNextEvent", ctypes.c_int, [ctypes.c_void_p, ctypes.c_char_p]),
    ("XFlush", ctypes.c_int, [ctypes.c_void_p]),
):  # fmt: skip
    getattr(X, name).restype, getattr(X, name).argtypes = result, arguments


class Source:
    """A window that offers one file."""

    def __init__(self, target, file):
        self.display = X.XOpenDisplay(None)
        self.target, self.data = target, f"{file.as_uri()}\r\n".encode()
        root = X.XDefaultRootWindow(self.display)
        self.window = X.XCreateSimpleWindow(self.display, root, 0, 0, 1, 1, 0, 0, 0)
        X.XSetSelectionOwner(self.display, self.atom("XdndSelection"), self.window, 0)

    def atom(self, name):
        return int(X.XInternAtom(self.display, name.encode(), 0))

    def tell(self, message, *data):
        """Send a client message whose first word is this window."""
        words = (self.window, *data, 0, 0, 0, 0)[:5]
        event = struct.pack(
            "i4xLi4xPLLi4x5L", CLIENT_MESSAGE, 0, 1, 0, self.target, self.atom(message), 32, *words
        )
        X.XSendEvent(self.display, self.target, 0, 0, event.ljust(EVENT, b"\0"))
        X.XFlush(self.display)

    def wait_for(self, message):
        """The client message, once it comes; hands the file's address over when asked for it on the way."""
        ends = time.monotonic() + PATIENCE_S
        event = ctypes.create_string_buffer(EVENT)
        while time.monotonic() < ends:
            if not X.XPending(self.display):
                time.sleep(0.02)
                continue
            X.XNextEvent(self.display, event)
            kind = struct.unpack_from("i", event.raw)[0]
            if kind == SELECTION_REQUEST:
                self._hand_over(event.raw)
            elif kind == CLIENT_MESSAGE and struct.unpack_from("L", event.raw, 40)[0] == self.atom(message):
                return event.raw
        sys.exit(f"the window sent no {message} in {PATIENCE_S:g} s")

    def _hand_over(self, request):
        requestor, selection, target, place, at = struct.unpack_from("5L", request, 40)
        X.XChangeProperty(self.display, requestor, place, target, 8, 0, self.data, len(self.data))
        reply = struct.pack("i4xLi4xP5L", SELECTION_NOTIFY, 0, 1, 0, requestor, selection, target, place, at)
        X.XSendEvent(self.display, requestor, 0, 0, reply.ljust(EVENT, b"\0"))
        X.XFlush(self.display)


def main():
    window, x, y, file = int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
    source = Source(window, file)
    source.tell("XdndEnter", VERSION << 24, source.atom("text/uri-list"))
    for _ in range(2):
        source.tell("XdndPosition", 0, x << 16 | y, 0, source.atom("XdndActionCopy"))
        status = source.wait_for("XdndStatus")
    if not struct.unpack_from("2L", status, 56)[1] & 1:
        sys.exit("the window does not take it")
    source.tell("XdndDrop", 0, 0)
    source.wait_for("XdndFinished")


if __name__ == "__main__":
    main()
