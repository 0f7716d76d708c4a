"""What is served stays on this machine: no other address, no other site's pages, no tunnel."""

import psutil
import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tg4mm.core.errors import Tg4mmError
from tg4mm.show.view.local_server import LocalServer, address, start_server, stop_server


@pytest.fixture
def server():
    started = start_server(0)
    yield started
    stop_server(started)


def listening(port: int) -> set[str]:
    """The addresses on which this process accepts connections at a port."""
    found = psutil.Process().net_connections(kind="inet")
    return {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN and c.laddr.port == port}


def test_it_listens_on_the_loopback_alone(server):
    assert listening(server.get_port()) == {"127.0.0.1"}
    assert address(server) == f"http://127.0.0.1:{server.get_port()}"


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "https://127.0.0.1.evil.example", "http://evil.example:8474"]
)
def test_pages_of_other_sites_are_turned_away(server, origin):
    with pytest.raises(InvalidStatus, match="403"):
        connect(
            f"ws://127.0.0.1:{server.get_port()}", origin=origin, subprotocols=[f"viser-v{viser.__version__}"]
        )


def test_its_own_page_gets_in(server):
    port = server.get_port()
    own = [f"viser-v{viser.__version__}"]
    with connect(f"ws://127.0.0.1:{port}", origin=f"http://127.0.0.1:{port}", subprotocols=own) as connection:
        assert connection.recv(timeout=10)


def test_no_page_can_open_a_tunnel(server):
    assert isinstance(server, LocalServer)
    assert server.request_share_url() is None
    assert server._share_tunnel is None


def test_a_port_in_use_is_said_in_one_line(server):
    port = server.get_port()
    with pytest.raises(Tg4mmError, match=rf"^port {port} on 127\.0\.0\.1 is in use.*--port$"):
        start_server(port)


def test_a_port_that_is_none_is_said():
    with pytest.raises(Tg4mmError, match="--port 99999: expected 0 … 65535"):
        start_server(99999)
