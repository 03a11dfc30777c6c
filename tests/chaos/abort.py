"""Peers that disconnect while a socket has stopped reading: how many processes does libzmq abort?

python -m tests.chaos.abort FOLDER TRIES [limit] [heartbeats] makes each fault TRIES times, each time in a process of
its own, and writes {fault: {exit status: processes}} to FOLDER/abort.json. With `limit` the sockets have a receive
limit, with `heartbeats` ZMTP heartbeats. Either makes libzmq abort, as `giirl_core.wire.transport` explains.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import zmq

from giirl_core.wire import transport
from giirl_core.wire.transport import Dealer, Keys, Router
from tests.chaos.raw_peer import GREETING, MESSAGE, OVERSIZED, PING, connect, damaging_relay, ready, reset, serve
from tests.chaos.storm import start

PARALLEL = 16  # processes
MESSAGES = 500  # that a peer sends while the other side does not read
LIMIT = 4  # messages
HEARTBEAT_MS = 30
HEARTBEATS_S = 0.15  # a few heartbeats
SETTLE_S = 0.05  # for bytes to arrive
WAIT_S = 10.0  # for what must happen
BLOCKING = b"x" * 100_000  # some of these fill a TCP connection


def weaken(*, limit: bool, heartbeats: bool) -> None:
    """Give the sockets of this process a receive limit or ZMTP heartbeats."""
    new_socket = transport._new_socket

    def new_weak_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int) -> zmq.Socket[bytes]:
        weak = new_socket(context, kind)
        if limit:
            weak.rcvhwm = LIMIT
        if heartbeats:
            weak.heartbeat_ivl, weak.heartbeat_timeout = HEARTBEAT_MS, 15_000
        return weak

    transport._new_socket = new_weak_socket


def reset_of_a_full_connection(router: Router) -> None:
    peer = connect(router.address)
    peer.sendall(MESSAGE * MESSAGES)
    time.sleep(SETTLE_S)
    reset(peer)


def close_of_a_full_connection(router: Router) -> None:
    peer = connect(router.address)
    peer.sendall(MESSAGE * MESSAGES)
    time.sleep(SETTLE_S)
    peer.close()


def pings_in_a_full_connection(router: Router) -> None:
    peer = connect(router.address)
    peer.sendall((MESSAGE + PING) * MESSAGES)
    time.sleep(SETTLE_S)
    reset(peer)
    time.sleep(SETTLE_S)
    receive_all(router)


def oversized_frame_in_a_full_connection(router: Router) -> None:
    peer = connect(router.address)
    peer.sendall(MESSAGE * (LIMIT + 1) + OVERSIZED + os.urandom(1000))
    time.sleep(SETTLE_S)
    with suppress(OSError):
        reset(peer)
    time.sleep(HEARTBEATS_S)
    receive_all(router)


def reset_after_the_identity_was_taken(router: Router) -> None:
    reset(_replaced_peer(router))


def close_after_the_identity_was_taken(router: Router) -> None:
    _replaced_peer(router).close()


def _replaced_peer(router: Router) -> socket.socket:
    """A peer that goes on sending although another connection has its identity."""
    first, second = (_introduced(router, b"a") for _ in range(2))
    time.sleep(SETTLE_S)
    first.sendall(MESSAGE * MESSAGES)
    time.sleep(SETTLE_S)
    threading.Timer(2 * HEARTBEATS_S, second.close).start()
    return first


def reset_while_the_router_closes(router: Router) -> None:
    peer = _introduced(router, b"a")
    while router.send(b"a", BLOCKING):
        pass
    disconnect = threading.Timer(SETTLE_S, _send_and_reset, [peer])
    disconnect.start()
    router.close()


def _introduced(router: Router, identity: bytes) -> socket.socket:
    """A peer whose first message the router has received."""
    peer = connect(router.address, identity=identity)
    peer.sendall(MESSAGE)
    assert router.recv(WAIT_S)
    return peer


def _send_and_reset(peer: socket.socket) -> None:
    with suppress(OSError):
        peer.sendall(MESSAGE * MESSAGES)
        time.sleep(SETTLE_S)
    reset(peer)


def reset_of_a_full_dealer() -> None:
    with closing(Dealer(serve(_send_and_reset), identity=b"a")):
        time.sleep(2 * SETTLE_S + HEARTBEATS_S)


def pings_in_a_full_dealer() -> None:
    def send(peer: socket.socket) -> None:
        peer.sendall((MESSAGE + PING) * MESSAGES)
        time.sleep(SETTLE_S)
        reset(peer)

    with closing(Dealer(serve(send), identity=b"a")) as dealer:
        time.sleep(3 * SETTLE_S)
        receive_all(dealer)


def reset_while_the_dealer_closes() -> None:
    peers: list[socket.socket] = []
    dealer = Dealer(serve(peers.append), identity=b"a")
    assert dealer.send(BLOCKING, timeout_s=WAIT_S)
    while dealer.send(BLOCKING):
        pass
    dealer.close()
    _send_and_reset(peers[0])


def damaged_handshakes() -> None:
    """Peers in both roles whose first bytes are damaged."""
    rng = random.Random()
    valid = GREETING + ready(b"DEALER", b"a") + (MESSAGE + PING) * 20

    def send_damaged(peer: socket.socket) -> None:
        data = bytearray(valid)
        for _ in range(rng.choice([1, 1, 1, 4])):
            data[rng.choice([rng.randrange(12), rng.randrange(130), rng.randrange(len(data))])] = rng.randrange(256)
        with suppress(OSError):
            peer.sendall(data[: rng.choice([len(data), rng.randrange(len(data))])])
            time.sleep(SETTLE_S / 10)
        rng.choice([reset, socket.socket.close])(peer)

    with closing(Router()) as router:
        host, _, port = router.address.rpartition(":")
        for _ in range(10):
            send_damaged(socket.create_connection((host, int(port)), WAIT_S))
            with closing(Dealer(serve(send_damaged, handshake=False), identity=b"a")) as dealer:
                dealer.recv(SETTLE_S / 10)
        receive_all(router)


def damaged_bytes() -> None:
    _damage(None)


def damaged_bytes_with_keys() -> None:
    _damage(Keys.generate())


def _damage(keys: Keys | None) -> None:
    """A router and a dealer send to each other, and do not read, over a relay that damages the bytes."""
    rng = random.Random()
    with closing(Router(keys=keys)) as router:
        address = damaging_relay(router.address, rng, intact=rng.randrange(3_000, 30_000))
        with closing(Dealer(address, identity=b"a", keys=keys)) as dealer:
            dealer.send(b"x" * 20, timeout_s=WAIT_S)
            router.recv(1.0)
            for _ in range(MESSAGES):
                dealer.send(b"x" * 20)
                router.send(b"a", b"y" * 20)
            time.sleep(HEARTBEATS_S)
            receive_all(router)
            receive_all(dealer)
            time.sleep(HEARTBEATS_S)


def receive_all(socket_: Router | Dealer) -> None:
    while socket_.recv(SETTLE_S) is not None:
        pass


FAULTS_OF_A_ROUTER: list[Callable[[Router], None]] = [
    reset_of_a_full_connection,
    close_of_a_full_connection,
    pings_in_a_full_connection,
    oversized_frame_in_a_full_connection,
    reset_after_the_identity_was_taken,
    close_after_the_identity_was_taken,
    reset_while_the_router_closes,
]
OTHER_FAULTS: list[Callable[[], None]] = [
    reset_of_a_full_dealer,
    pings_in_a_full_dealer,
    reset_while_the_dealer_closes,
    damaged_handshakes,
    damaged_bytes,
    damaged_bytes_with_keys,
]


def with_router(fault: Callable[[Router], None]) -> Callable[[], None]:
    def make() -> None:
        router = Router()
        fault(router)
        time.sleep(HEARTBEATS_S)

    return make


FAULTS: dict[str, Callable[[], None]] = {
    **{fault.__name__: with_router(fault) for fault in FAULTS_OF_A_ROUTER},
    **{fault.__name__: fault for fault in OTHER_FAULTS},
}


def _exit_after(fault: Callable[[], None]) -> Callable[[], None]:
    def make() -> None:
        fault()
        time.sleep(HEARTBEATS_S)
        os._exit(0)

    return make


def run(tries: int) -> dict[str, dict[str, int]]:
    """Make each fault `tries` times; returns how many processes ended with which exit status."""
    statuses: dict[str, Counter[str]] = {name: Counter() for name in FAULTS}
    running: dict[int, str] = {}
    for number in range(tries * len(FAULTS) + PARALLEL):
        if len(running) == PARALLEL or (running and number >= tries * len(FAULTS)):
            pid, status = os.wait()
            code = os.waitstatus_to_exitcode(status)
            statuses[running.pop(pid)][signal.Signals(-code).name if code < 0 else str(code)] += 1
        if number < tries * len(FAULTS):
            name = list(FAULTS)[number % len(FAULTS)]
            running[start(name, _exit_after(FAULTS[name]))] = name
    return {name: dict(counts) for name, counts in statuses.items()}


def main() -> None:
    folder, tries, weaknesses = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    weaken(limit="limit" in weaknesses, heartbeats="heartbeats" in weaknesses)
    (folder / "abort.json").write_text(json.dumps(run(tries), indent=2) + "\n")


if __name__ == "__main__":
    main()
