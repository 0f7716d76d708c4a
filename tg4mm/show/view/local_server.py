"""viser's web server on 127.0.0.1 with a token in its address: access, the page's policy, and its side panel."""

import hmac
import logging
import os
import re
import secrets
import socket
import tempfile
import warnings
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from threading import Lock
from typing import Any

import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tg4mm.core.errors import Tg4mmError
from tg4mm.show.view.charts import ACCENT_RGB, SCRIPT, STYLE

LARGEST_MESSAGE = 1 << 16  # bytes; a camera or a slider is a few hundred
# Any port, since a tunnel from another machine may end at another one.
_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?")
_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"
# Elements of style and script that viser's page makes get the answer's nonce. Its unused sorter of Gaussians would
# evaluate text.
_HEAD = """<script nonce="{nonce}">{{
const {{nonce}} = document.currentScript, make = Document.prototype.createElement;
Document.prototype.createElement = function (...given) {{
  const element = make.apply(this, given);
  if (element instanceof HTMLStyleElement || element instanceof HTMLScriptElement) element.nonce = nonce;
  return element;
}};
addEventListener("unhandledrejection", (event) => {{
  if (event.reason instanceof EvalError) event.preventDefault();
}});
{script}
}}</script><style nonce="{nonce}">{style}</style>"""
_POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}' 'wasm-unsafe-eval'; style-src 'nonce-{nonce}'; worker-src blob:; "
    "connect-src ws://{host} data: blob:; img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HOST = "127.0.0.1"
_PANEL = 400  # pixels
_starting = Lock()


class Guard:
    """Admits requests with the token, which is the path of the page's address, and no page of another origin."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the page, a refusal, or None to let the page's websocket open."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        websocket = request.headers.get("Upgrade", "").lower() == "websocket"
        if len(hosts) != 1 or _HOST.fullmatch(hosts[0]) is None:
            return _refused(HTTPStatus.FORBIDDEN, "not an address of this machine")
        if (origins or websocket) and origins != [f"http://{hosts[0]}"]:
            return _refused(HTTPStatus.FORBIDDEN, "a page of another origin")
        path = request.path.partition("?")[0].strip("/")
        if not hmac.compare_digest(path.encode("utf-8", "replace"), self.token.encode()):
            return _refused(
                HTTPStatus.NOT_FOUND, "the address is the one that tg4mm view prints, token included"
            )
        return None if websocket else _page(hosts[0])


def _page(host: str) -> Response:
    """Return viser's page with a new nonce and its policy."""
    nonce = secrets.token_urlsafe(16)
    page = _PAGE.read_text(encoding="utf-8").replace("<script ", f'<script nonce="{nonce}" ')
    page = page.replace("<head>", "<head>" + _HEAD.format(nonce=nonce, script=SCRIPT, style=STYLE), 1)
    policy = _POLICY.format(nonce=nonce, host=host)
    return _response(HTTPStatus.OK, "text/html; charset=utf-8", page, policy)


def _refused(status: HTTPStatus, words: str) -> Response:
    return _response(
        status, "text/plain; charset=utf-8", words + "\n", "default-src 'none'; frame-ancestors 'none'"
    )


def _response(status: HTTPStatus, kind: str, text: str, policy: str) -> Response:
    body = text.encode()
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
            "Connection": "close",
        }
    )
    return Response(status.value, status.phrase, headers, body)


class LocalServer(viser.ViserServer):
    """viser's server behind a guard, without its tunnel to the internet."""

    guard: Guard

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None, since pages stay on this machine."""
        return None


def start_server(port: int) -> LocalServer:
    """Serve on 127.0.0.1:`port`; 0 takes any free one. Raises Tg4mmError if the port is taken.

    viser alone would take the next free port.
    """
    # Refused pages of other sites, and pages closed during drawing, are no errors.
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
            return serve(handler, *args, **options)

        # viser has no argument for a guard; the command prints the address itself
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


def add_side_panel(server: LocalServer, shown: Path) -> None:
    """Put the controls into a panel on the right, named after the displayed file or folder."""
    set_theme(server)
    server.gui.set_panel_label(f"tg4mm view: {shown.resolve().name}")
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(_PANEL)


def set_theme(server: LocalServer, dark: bool = False) -> None:
    """Set the light or dark theme of all pages."""
    server.gui.configure_theme(
        dark_mode=dark, show_logo=False, show_share_button=False, brand_color=ACCENT_RGB
    )


def stop_server(server: LocalServer) -> None:
    """Close all connections and stop serving."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        server.stop()
    finally:
        console.quiet = quiet


def address(server: LocalServer) -> str:
    """Return the server's address, which includes the token."""
    return f"http://{HOST}:{server.get_port()}/{server.guard.token}/"


@contextmanager
def browsed(url: str, folder: Path) -> Iterator[None]:
    """Open the browser at `url` through a file in `folder` that only its owner can read.

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
