"""The viewer on a machine that others share: who is let in, by raw sockets and from a browser's other pages."""

import math
import re
import socket
import stat
import threading
import time
import webbrowser
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import msgspec
import psutil
import pytest
import viser
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.show.view.browser import browser
from tg4mm.core.magnification import Magnification
from tg4mm.show.view.app import App
from tg4mm.show.view.local_server import LARGEST_MESSAGE, address, browsed, start_server, stop_server
from tg4mm.show.view.session import DisplaySettings, PlaybackClock, Session

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, -4.0], "fov": 0.8,
    "near": 0.01, "far": 1000.0, "image_height": 48, "image_width": 64, "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip
UPGRADE = (
    "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
)  # fmt: skip


@pytest.fixture(scope="module")
def server():
    started = start_server(0)
    yield started
    stop_server(started)


@pytest.fixture(scope="module")
def app(scene, tmp_path_factory):
    session = Session(
        scene, DisplaySettings(Magnification.of(5.0)), PlaybackClock(scene.duration, playing=True)
    )
    made = App(session, 0, tmp_path_factory.mktemp("saved"))
    yield made
    made.stop()


def asked(server, path, *headers, host=None):
    """Status, headers and body of a GET that a program sends by itself."""
    named = f"127.0.0.1:{server.get_port()}" if host is None else host
    lines = [f"GET {path} HTTP/1.1", *([f"Host: {named}"] if named else []), *headers, "", ""]
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=20) as raw:
        raw.sendall("\r\n".join(lines).encode("latin-1"))
        answer = b""
        while b"\r\n\r\n" not in answer or b"101 Switching" not in answer:
            if not (part := raw.recv(1 << 16)):
                break
            answer += part
    head, _, body = answer.decode("utf-8", "replace").partition("\r\n\r\n")
    return int(head.split()[1]), head, body


def entered(server, **options):
    """A connection as the page opens it."""
    url = address(server).rstrip("/")
    options = {"origin": "http://" + url.split("/")[2], "max_size": None} | options
    return connect(url.replace("http", "ws", 1), subprotocols=[f"viser-v{viser.__version__}"], **options)


def test_it_listens_on_the_loopback_alone(server):
    found = psutil.Process().net_connections(kind="inet")
    port = server.get_port()
    ips = {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN and c.laddr.port == port}
    assert ips == {"127.0.0.1"}
    assert re.fullmatch(rf"http://127\.0\.0\.1:{port}/[\w-]{{32}}/", address(server))


def test_the_page_has_a_policy_without_unsafe_inline(server):
    status, head, body = asked(server, f"/{server.guard.token}/?darkMode")
    assert status == 200
    policy = re.search("Content-Security-Policy: (.*)\r\n", head)[1]
    assert "unsafe-inline" not in policy
    assert "unsafe-eval" not in policy.replace("wasm-unsafe-eval", "")
    assert "frame-ancestors 'none'" in policy
    nonces = set(re.findall(r"'nonce-([^']+)'", policy))
    assert nonces == set(re.findall(r'<(?:script|style) nonce="([^"]+)"', body))
    assert nonces != set(re.findall(r"'nonce-([^']+)'", asked(server, f"/{server.guard.token}")[1]))


@pytest.mark.parametrize("upgrade", [(), UPGRADE], ids=["page", "websocket"])
@pytest.mark.parametrize(
    ("host", "origin", "path", "status"),
    [
        (None, "own", "/", 404),
        (None, "own", "/index.html", 404),
        (None, "own", "/{token}x", 404),
        (None, "own", "/{token}/../../../etc/passwd", 404),
        (None, "own", "/%00é", 404),
        ("evil.example", "http://evil.example", "/{token}", 403),
        ("127.0.0.1.evil.example:{port}", "http://127.0.0.1.evil.example:{port}", "/{token}", 403),
        ("", "own", "/{token}", 403),
        (None, "http://evil.example", "/{token}", 403),
        (None, "https://127.0.0.1:{port}", "/{token}", 403),
        (None, "http://127.0.0.1:1", "/{token}", 403),
        (None, "http://localhost:1", "/{token}", 403),
        (None, "http://localhost:{port}", "/{token}", 403),
        (None, "null", "/{token}", 403),
    ],
)
def test_whoever_is_not_meant_is_turned_away(server, host, origin, path, status, upgrade):
    known = {"port": server.get_port(), "token": server.guard.token}
    own = f"http://127.0.0.1:{known['port']}" if origin == "own" else origin.format(**known)
    named = None if host is None else host.format(**known)
    got = asked(server, path.format(**known), f"Origin: {own}", *upgrade, host=named)
    assert got[0] == status
    assert server.guard.token not in got[1] + got[2]


def test_a_websocket_without_an_origin_is_turned_away(server):
    with pytest.raises(InvalidStatus, match="403"):
        entered(server, origin=None)


def test_its_own_page_gets_in_through_a_tunnel_too(server):
    path = f"/{server.guard.token}"
    origin = "Origin: http://localhost:9000"
    assert asked(server, path, host="localhost:9000")[0] == 200
    status = asked(server, path, origin, *UPGRADE, host="localhost:9000")[0]
    assert status == 101


def test_no_page_can_open_a_tunnel(server):
    assert server.request_share_url() is None
    assert server._share_tunnel is None


def test_other_users_cannot_read_where_the_browser_goes(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(webbrowser, "open", seen.append)
    with browsed("http://127.0.0.1:1/secret/", tmp_path):
        (file,) = tmp_path.iterdir()
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert "http://127.0.0.1:1/secret/" in file.read_text()
        assert seen == [file.as_uri()]
    assert not list(tmp_path.iterdir())


def send(connection, **message):
    connection.send(msgspec.msgpack.encode(message))


def pictured(connection, seconds=30.0):
    """Waits for a picture; how many bytes."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        raw = connection.recv(timeout=seconds)
        decoded = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + int.from_bytes(raw[8:16], "little")])
        messages = msgspec.msgpack.decode(decoded)["messages"]
        if any(message["type"] == "BackgroundImageMessage" for message in messages):
            return len(raw)
    raise AssertionError("no picture came")


def test_the_nonsense_of_one_client_ends_nothing_for_another(app, capfd):
    bad = [{"image_width": 0}, {"image_height": -1}, {"fov": math.pi}, {"fov": math.nan}, {"wxyz": [0.0] * 4},
           {"position": [math.nan, 0, 0]}, {"position": [1e300, 0, 0]}, {"image_width": 10**9}]  # fmt: skip
    with entered(app.server) as good, entered(app.server) as other:
        send(good, **CAMERA)
        pictured(good)
        for change in bad:
            send(other, **CAMERA | change)
            pictured(good)
        send(other, **CAMERA)
        pictured(other)
        other.send(b"\xc4" * (LARGEST_MESSAGE + 1))
        with pytest.raises(ConnectionClosed):
            all(other.recv(timeout=20) for _ in range(1000))
        for _ in range(3):
            pictured(good)
        assert app._failure is None
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "change",
    [
        {"fov": 0.0011}, {"fov": 3.13}, {"position": [1e11, 0.0, 0.0]},
        {"position": [0.0, 0.0, 0.0], "look_at": [0.0, 0.0, 1.0]},
        {"image_width": 16384, "image_height": 1}, {"image_width": 7680, "image_height": 4320},
    ],
)  # fmt: skip
def test_pictures_stay_bounded_wherever_a_client_looks_from(app, change):
    with entered(app.server) as client:
        send(client, **CAMERA | change)
        assert pictured(client) < 5e6  # bytes
    assert app._failure is None


def test_a_page_of_another_port_gets_nothing_in_a_browser(app, tmp_path):
    """Neither as a frame, nor by fetch, nor by websocket, though it knows the token."""
    (tmp_path / "index.html").write_text(f'<iframe src="{app.url}"></iframe>')
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with browser() as chromium, ThreadingHTTPServer(("127.0.0.1", 0), handler) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page = chromium.new_page()
        said = []
        page.on("console", lambda message: said.append(message.text))
        page.goto(f"http://localhost:{other.server_port}/")
        assert page.evaluate(f"fetch('{app.url}').then(() => 'in', () => 'out')") == "out"
        opened = f"""new Promise((resolve) => {{
            const socket = new WebSocket("{app.url.rstrip("/").replace("http", "ws")}", ["viser-v{viser.__version__}"]);
            socket.onopen = () => resolve("in"); socket.onerror = () => resolve("out");
        }})"""
        assert page.evaluate(opened) == "out"
        page.wait_for_timeout(500)
        assert any("frame-ancestors" in text for text in said), said
        other.shutdown()
