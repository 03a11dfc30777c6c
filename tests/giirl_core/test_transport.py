"""Routers and dealers on loopback: delivery, timeouts, reconnection, authentication and limits."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest
import zmq

from giirl_core.wire.transport import Dealer, Keys, Router

WAIT_S = 10.0


@pytest.fixture
def router() -> Iterator[Router]:
    with closing(Router()) as listening:
        yield listening


def test_messages_pass_in_both_directions(router: Router) -> None:
    with closing(Dealer(router.address, identity=b"a")) as dealer:
        for message in (b"one", b"", b"two" * 100_000):
            assert dealer.send(message, timeout_s=WAIT_S)
            assert router.recv(WAIT_S) == (b"a", message)
            assert router.send(b"a", message)
            assert dealer.recv(WAIT_S) == message


def test_a_message_in_several_frames_is_received_as_empty(router: Router) -> None:
    with zmq.Context() as context, context.socket(zmq.DEALER) as foreign:
        foreign.identity, foreign.linger = b"a", 0
        foreign.connect(f"tcp://{router.address}")
        foreign.send_multipart([b"one", b"", b"two"])
        assert router.recv(WAIT_S) == (b"a", b"")
        foreign.send(b"whole")
        assert router.recv(WAIT_S) == (b"a", b"whole")
    with zmq.Context() as context, context.socket(zmq.ROUTER) as foreign:
        foreign.linger = 0
        port = foreign.bind_to_random_port("tcp://127.0.0.1")
        with closing(Dealer(f"127.0.0.1:{port}", identity=b"a")) as dealer:
            assert dealer.send(b"x", timeout_s=WAIT_S)
            peer, _ = foreign.recv_multipart()
            foreign.send_multipart([peer, b"one", b"two"])
            assert dealer.recv(WAIT_S) == b""


def test_every_wait_ends_at_its_timeout(router: Router) -> None:
    assert router.recv(0.01) is None
    with closing(Dealer("127.0.0.1:1", identity=b"a")) as dealer:
        assert dealer.recv(0.01) is None
        assert not dealer.send(b"x", timeout_s=0.01)


def test_a_message_to_an_unknown_peer_is_reported_as_not_sent(router: Router) -> None:
    assert not router.send(b"unknown", b"x")


def test_another_thread_can_wake_a_router(router: Router) -> None:
    waker = threading.Timer(0.05, router.wake)
    waker.start()
    assert router.recv(600.0) is None  # longer than any test may take
    waker.join()
    for _ in range(100_000):
        router.wake()  # must not block when the pipe is full


def test_a_peer_that_reconnects_keeps_its_identity(router: Router) -> None:
    with closing(Dealer(router.address, identity=b"a")) as first:
        assert first.send(b"1", timeout_s=WAIT_S)
        assert router.recv(WAIT_S) == (b"a", b"1")
        with closing(Dealer(router.address, identity=b"a")) as second:
            assert second.send(b"2", timeout_s=WAIT_S)
            assert router.recv(WAIT_S) == (b"a", b"2")
            assert router.send(b"a", b"3")
            assert second.recv(WAIT_S) == b"3"


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "*", "example.invalid"])
def test_without_keys_a_router_listens_on_loopback_only(host: str) -> None:
    with pytest.raises(ValueError, match="without CURVE keys"):
        Router(host)


def test_with_keys_a_router_listens_on_any_address() -> None:
    with closing(Router("0.0.0.0", keys=Keys.generate())) as router:
        assert router.address.startswith("0.0.0.0:")


def test_only_holders_of_the_keys_can_connect() -> None:
    keys, others = Keys.generate(), Keys.generate()
    with closing(Router(keys=keys)) as router:
        with closing(Dealer(router.address, identity=b"a", keys=keys)) as dealer:
            assert dealer.send(b"x", timeout_s=WAIT_S)
            assert router.recv(WAIT_S) == (b"a", b"x")
        for wrong in (others, None):
            with closing(Dealer(router.address, identity=b"b", keys=wrong)) as dealer:
                assert not dealer.send(b"x", timeout_s=0.5)
                assert dealer.refusals
                assert router.recv(0.0) is None
        assert router.refusals


def test_a_client_with_a_key_of_its_own_can_connect_while_it_is_allowed() -> None:
    own = Keys.generate()
    with closing(Router(keys=Keys.generate())) as router:
        with closing(Dealer(router.address, identity=b"a", keys=own)) as dealer:
            assert not dealer.send(b"x", timeout_s=0.5)
            router.allow([Keys.generate().public, own.public])
            deadline_s = time.monotonic() + WAIT_S
            while not dealer.send(b"x", timeout_s=0.05):  # it tries again by itself
                assert time.monotonic() < deadline_s
            assert router.recv(WAIT_S) == (b"a", b"x")
        router.allow([])
        with closing(Dealer(router.address, identity=b"a", keys=own)) as dealer:
            assert not dealer.send(b"x", timeout_s=0.5)


def test_a_router_with_another_key_than_its_address_says_is_not_spoken_to() -> None:
    keys, impostor = Keys.generate(), Keys.generate()
    with closing(Router(keys=impostor)) as router:
        router.allow([keys.public])
        address = f"{router.address.partition(' ')[0]} {Keys.generate().public.decode()}"
        with closing(Dealer(address, identity=b"a", keys=keys)) as dealer:
            assert not dealer.send(b"x", timeout_s=0.5)


def test_routers_and_dealers_speak_ipv6() -> None:
    if not Path("/proc/net/if_inet6").exists():
        pytest.skip("this machine has no IPv6")
    with closing(Router("::1")) as router, closing(Dealer(router.address, identity=b"a")) as dealer:
        assert router.address.startswith("[::1]:")
        assert dealer.send(b"x", timeout_s=WAIT_S)
        assert router.recv(WAIT_S) == (b"a", b"x")
    with pytest.raises(ValueError, match="without CURVE keys"):
        Router("::")


@pytest.mark.parametrize("holder", [True, False])
def test_the_public_key_alone_is_not_enough_to_connect(holder: bool) -> None:
    keys = Keys.generate()
    own = keys if holder else Keys.generate()
    with closing(Router(keys=keys)) as router, zmq.Context() as context, context.socket(zmq.DEALER) as client:
        client.linger = 0
        client.curve_serverkey = keys.public
        client.curve_publickey = own.public
        client.curve_secretkey = own.secret
        client.connect(f"tcp://{router.address.partition(' ')[0]}")
        client.send(b"x")
        assert (router.recv(WAIT_S if holder else 0.5) is not None) == holder


def test_only_the_sender_of_a_too_large_message_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("giirl_core.wire.transport.MAX_BYTES", 10_000)
    with closing(Router()) as router, closing(Dealer(router.address, identity=b"a")) as dealer:
        with zmq.Context() as context, context.socket(zmq.DEALER) as sender:
            sender.linger = 0
            sender.connect(f"tcp://{router.address}")
            sender.send(b"x" * 10_001)
            assert router.recv(0.5) is None
        assert dealer.send(b"x" * 10_000, timeout_s=WAIT_S)
        assert router.recv(WAIT_S) == (b"a", b"x" * 10_000)


def test_a_peer_can_send_without_limit_while_its_messages_are_not_received(router: Router) -> None:
    with closing(Dealer(router.address, identity=b"a")) as dealer:
        for number in range(20_000):
            assert dealer.send(b"%d" % number, timeout_s=WAIT_S)
        assert [router.recv(WAIT_S) for _ in range(20_000)] == [(b"a", b"%d" % n) for n in range(20_000)]


def test_the_kernel_finds_dead_peers_of_both_ends_of_a_connection(router: Router) -> None:
    with closing(Dealer(router.address, identity=b"a")) as dealer:
        assert dealer.send(b"x", timeout_s=WAIT_S)
        assert router.recv(WAIT_S)
        assert list(_connections(router.address)) == [(1, 5, 5, 15_000)] * 2


def _connections(address: str) -> Iterator[tuple[int, ...]]:
    """Keepalive options of this process's ends of connections with `address`."""
    tcp = [socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_USER_TIMEOUT]
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile, or not connected
            if not str(entry.readlink()).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as end:
                if end.family == socket.AF_INET and address in [
                    "{}:{}".format(*name) for name in (end.getsockname(), end.getpeername())
                ]:
                    options = [end.getsockopt(socket.IPPROTO_TCP, option) for option in tcp]
                    yield end.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE), *options


def test_a_bad_key_is_refused_and_a_secret_is_not_in_the_repr() -> None:
    keys = Keys.generate()
    with pytest.raises(ValueError, match="Z85"):
        Keys(public=b"short", secret=b"short")
    with pytest.raises(ValueError, match="does not belong"):
        Keys(public=Keys.generate().public, secret=keys.secret)
    assert keys.secret.decode() not in repr(keys)


def test_bad_ports_addresses_and_identities_are_refused(router: Router) -> None:
    port = int(router.address.rpartition(":")[2])
    with pytest.raises(ValueError, match=rf"cannot listen on 127\.0\.0\.1:{port}: .*wanted a free port"):
        Router(port=port)
    with pytest.raises(ValueError, match="out of range"):
        Router(port=70_000)
    with pytest.raises(ValueError, match="wanted host:port"):
        Dealer("nowhere", identity=b"a")
    with pytest.raises(ValueError, match="wanted 1 to 255 bytes"):
        Dealer(router.address, identity=b"")


def test_an_http_client_on_the_port_does_no_harm(router: Router) -> None:
    host, _, port = router.address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=WAIT_S) as foreign:
        foreign.sendall(b"GET / HTTP/1.1\r\n\r\n" * 10)
        with closing(Dealer(router.address, identity=b"a")) as dealer:
            assert dealer.send(b"x", timeout_s=WAIT_S)
            assert router.recv(WAIT_S) == (b"a", b"x")
