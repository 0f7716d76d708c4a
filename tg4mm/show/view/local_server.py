"""viser's web server, for this machine alone: bound to 127.0.0.1, no other site's pages, no way out."""

import logging
import re
import socket
import warnings
from functools import partial
from threading import Lock

import rich
import viser
import websockets.asyncio.server

from tg4mm.core.errors import Tg4mmError

HOST = "127.0.0.1"
# The browser says which page opens a connection; those of other sites would otherwise get in through it.
_ORIGINS = [None, re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?")]
_starting = Lock()


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the internet, which any page could ask it to open."""

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
        serve, quiet = websockets.asyncio.server.serve, console.quiet
        # viser passes no list of origins on; its announcements say what the command says itself
        websockets.asyncio.server.serve = partial(serve, origins=_ORIGINS)  # type: ignore[assignment, misc]
        console.quiet = True
        try:
            server = LocalServer(host=HOST, port=port, verbose=False)
        finally:
            websockets.asyncio.server.serve, console.quiet = serve, quiet  # type: ignore[misc]
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
    """Where the browser finds it."""
    return f"http://{HOST}:{server.get_port()}"


def _check_free(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            raise _taken(port) from None


def _taken(port: int) -> Tg4mmError:
    return Tg4mmError(f"port {port} on {HOST} is in use, or not allowed: choose another with --port")
