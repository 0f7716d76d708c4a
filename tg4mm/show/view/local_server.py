"""viser's web server, for whoever started it: bound to 127.0.0.1, a token in its address, no way out."""

import logging
import os
import socket
import tempfile
import warnings
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Any

import rich
import viser
import websockets.asyncio.server

from tg4mm.core.errors import Tg4mmError
from tg4mm.show.view.guard import LARGEST_MESSAGE, Guard

HOST = "127.0.0.1"
_starting = Lock()


class LocalServer(viser.ViserServer):
    """viser's server behind a guard, without its tunnel to the internet."""

    guard: Guard

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Always None: what is served here stays on this machine."""
        return None


def start_server(port: int) -> LocalServer:
    """Serve on 127.0.0.1:`port`; 0 takes any free one. Raises Tg4mmError where the port is taken.

    viser itself would go on to the next free port.
    """
    # Neither a page of another site that is turned away nor one that was closed while its picture was drawn is news.
    logging.getLogger("websockets").setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    if not 0 <= port <= 65535:
        raise Tg4mmError(f"--port {port}: expected 0 … 65535")
    _check_free(port)
    console = rich.get_console()
    with _starting:
        serve, quiet, guard = websockets.asyncio.server.serve, console.quiet, Guard()

        def guarded(handler: Any, *args: Any, **options: Any) -> Any:
            options |= {"process_request": guard.answer, "max_size": LARGEST_MESSAGE}
            return serve(guard.checked(handler), *args, **options)

        # viser hands on no guard; its announcements say what the command says itself
        websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
        console.quiet = True
        try:
            server = LocalServer(host=HOST, port=port, verbose=False)
        finally:
            websockets.asyncio.server.serve, console.quiet = serve, quiet  # type: ignore[misc]
    server.guard = guard
    if port and server.get_port() != port:
        stop_server(server)
        raise _taken(port)
    return server


def stop_server(server: LocalServer) -> None:
    """Close all connections and stop serving."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        server.stop()
    finally:
        console.quiet = quiet


def address(server: LocalServer) -> str:
    """Where the browser finds it; whoever knows it is let in."""
    return f"http://{HOST}:{server.get_port()}/{server.guard.token}/"


@contextmanager
def browsed(url: str, folder: Path) -> Iterator[None]:
    """Open the browser at `url` by a file in `folder` that its owner alone can read.

    All users of a machine see the arguments of a program.
    """
    try:
        handle, name = tempfile.mkstemp(".html", ".view-", folder)
    except OSError:
        handle, name = tempfile.mkstemp(".html", "tg4mm-view-")
    with os.fdopen(handle, "w") as file:
        file.write(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><title>tg4mm view</title>\n'
        )
    try:
        webbrowser.open(Path(name).resolve().as_uri())
        yield
    finally:
        with suppress(OSError):
            os.unlink(name)


def _check_free(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            raise _taken(port) from None


def _taken(port: int) -> Tg4mmError:
    return Tg4mmError(f"port {port} on {HOST} is in use, or not allowed: choose another with --port")
