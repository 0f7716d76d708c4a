"""Who is let in, what the page may do in the browser, and which messages of a page are let through."""

import hmac
import math
import re
import secrets
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from pathlib import Path
from typing import Any

import msgspec
import viser
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tg4mm.show.view.charts import SCRIPT, STYLE

LARGEST_MESSAGE = 1 << 16  # bytes; a camera or a slider is a few hundred
LARGEST_CANVAS = 1 << 14, 1 << 25  # pixels a side, and of the whole: 8K has 33 million
_FARTHEST = 1e12  # scene units
_NARROWEST = 1e-3  # radians, that a field of view is from 0 and from π
_LONGEST = 1000  # characters of a text
# Any port: a tunnel from another machine ends at one of its own.
_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?")
_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"
# viser's page makes elements of style and script as it goes: they get the answer's nonce. Its sorter of Gaussians,
# which is not used, would evaluate text.
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


class Guard:
    """Lets in whoever knows the token, which is the path of the page's address, and no page of another origin."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None: the websocket of the page may open."""
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

    def checked(self, handler: Callable[[ServerConnection], Awaitable[None]]) -> Any:
        """`handler`, whose connections give sensible messages alone."""

        async def handle(connection: ServerConnection) -> None:
            receive = connection.recv

            async def received(*_: object) -> object:
                while not _sensible(raw := await receive()):
                    pass
                return raw

            connection.recv = received  # type: ignore[assignment, method-assign]
            await handler(connection)

        return handle


def _sensible(raw: object) -> bool:
    """Whether a message is of a kind that the page sends, moves nothing but a value, and can be calculated with."""
    try:
        message = msgspec.msgpack.decode(raw) if isinstance(raw, bytes) else None
    except (msgspec.DecodeError, RecursionError):
        return False
    if not isinstance(message, dict) or not _bounded(message):
        return False
    kind, updates = message.get("type"), message.get("updates")
    if kind == "GuiUpdateMessage":  # viser sets whatever attribute is named
        return isinstance(updates, dict) and updates.keys() == {"value"} and updates["value"] is not None
    return kind == "ScenePointerMessage" or (kind == "ViewerCameraMessage" and _is_camera(message))


def _bounded(value: object) -> bool:
    """Whether all numbers in JSON-like data are finite and not huge, and all texts short."""
    if isinstance(value, dict):
        return all(map(_bounded, value.values()))
    if isinstance(value, list):
        return all(map(_bounded, value))
    if isinstance(value, (int, float)):
        return abs(value) < _FARTHEST
    return value is None or (isinstance(value, str) and len(value) <= _LONGEST)


def _is_camera(message: dict[str, Any]) -> bool:
    """Whether it is whole, of a canvas that memory is there for, and looks somewhere."""
    try:
        sizes = message["image_width"], message["image_height"]
        return (
            all(0 < size <= LARGEST_CANVAS[0] for size in sizes)
            and math.prod(sizes) <= LARGEST_CANVAS[1]
            and _NARROWEST < message["fov"] < math.pi - _NARROWEST
            and len(message["wxyz"]) == 4
            and 0.5 < math.hypot(*message["wxyz"]) < 2.0
            and all(len(message[name]) == 3 for name in ("position", "look_at", "up_direction"))
            and min(math.dist(message["position"], message["look_at"]), math.hypot(*message["up_direction"]))
            > 0
        )
    except (KeyError, TypeError):
        return False


def _page(host: str) -> Response:
    """viser's page with a nonce of its own, and the policy that goes with it."""
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
