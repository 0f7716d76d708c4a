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
_CAMERA = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3, "fov": 0, "near": 0, "far": 0,
           "image_height": 0, "image_width": 0}  # fmt: skip
_CLICK = {"event_type", "ray_origin", "ray_direction", "screen_pos", "modifier"}


class Guard:
    """Lets in whoever knows the token, which is the path of the page's address, and no page of another origin."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)
        self.server: viser.ViserServer | None = None  # whose controls the pages move

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
                while not self._sensible(raw := await receive()):
                    pass
                return raw

            connection.recv = received  # type: ignore[assignment, method-assign]
            await handler(connection)

        return handle

    def _sensible(self, raw: object) -> bool:
        try:
            message = msgspec.msgpack.decode(raw) if isinstance(raw, bytes) else None
        except (msgspec.DecodeError, RecursionError):
            return False
        if not isinstance(message, dict):
            return False
        kind = message.pop("type", None)
        if kind == "ViewerCameraMessage":
            return _is_camera(message)
        if kind == "ScenePointerMessage":
            return message.keys() == _CLICK and _is_click(message)
        return kind == "GuiUpdateMessage" and message.keys() == {"uuid", "updates"} and self._is_move(message)

    def _is_move(self, message: dict[str, Any]) -> bool:
        """Whether a control is there that can have the value."""
        uuid, updates = message["uuid"], message["updates"]
        if self.server is None or not isinstance(uuid, str) or not isinstance(updates, dict):
            return False
        guis = (self.server.gui, *(client.gui for client in self.server.get_clients().values()))
        found = (gui._gui_input_handle_from_uuid.get(uuid) for gui in guis)
        handle = next((one for one in found if one is not None), None)
        return handle is not None and updates.keys() == {"value"} and _fits(updates["value"], handle)


def _fits(value: Any, handle: Any) -> bool:
    """Whether `value` is of the kind of a control's own, within its bounds or among its options."""
    options = getattr(handle, "options", None)
    if options is not None:
        return isinstance(value, str) and value in options
    if isinstance(handle.value, tuple):
        if not (isinstance(value, list) and len(value) == len(handle.value)):
            return False
        ordered = not isinstance(handle, viser.GuiMultiSliderHandle) or value == sorted(value, key=_number)
        return ordered and all(map(_fits_one, value, handle.value, [handle] * len(value)))
    return _fits_one(value, handle.value, handle)


def _fits_one(value: object, own: object, handle: object) -> bool:
    if isinstance(own, bool):
        return isinstance(value, bool)
    if isinstance(own, str):
        return isinstance(value, str) and len(value) <= _LONGEST
    low, high = (getattr(handle, name, None) for name in ("min", "max"))
    low, high = (-math.inf if low is None else _number(low)), (math.inf if high is None else _number(high))
    return _finite(value) and not _number(value) < low and not _number(value) > high


def _is_camera(message: dict[str, Any]) -> bool:
    if message.keys() != _CAMERA.keys() or not all(_finite(message[k], n) for k, n in _CAMERA.items()):
        return False
    sizes = message["image_width"], message["image_height"]
    return (
        all(isinstance(size, int) and 0 < size <= LARGEST_CANVAS[0] for size in sizes)
        and math.prod(sizes) <= LARGEST_CANVAS[1]
        and _NARROWEST < message["fov"] < math.pi - _NARROWEST
        and 0.5 < math.hypot(*message["wxyz"]) < 2.0
        and min(math.dist(message["position"], message["look_at"]), math.hypot(*message["up_direction"])) > 0
    )


def _is_click(message: dict[str, Any]) -> bool:
    place, rays = message["screen_pos"], (message["ray_origin"], message["ray_direction"])
    is_box = message["event_type"] == "rect-select"
    return (
        (
            rays == (None, None)
            if is_box
            else message["event_type"] == "click" and all(_finite(r, 3) for r in rays)
        )
        and isinstance(place, list)
        and len(place) == 1 + is_box
        and all(_finite(at, 2) and (is_box or all(0 <= share <= 1 for share in at)) for at in place)
        and (message["modifier"] is None or isinstance(message["modifier"], str))
    )


def _finite(value: object, count: int = 0) -> bool:
    """Whether it is a number that can be calculated with, or `count` of them."""
    if count:
        return isinstance(value, list) and len(value) == count and all(map(_finite, value))
    return abs(_number(value)) < _FARTHEST


def _number(value: object) -> float:
    """NaN for what is no number."""
    return math.nan if isinstance(value, bool) or not isinstance(value, (int, float)) else float(value)


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
