"""Addresses of sockets: "host:port" or "[IPv6]:port", and where connections are encrypted "host:port PUBLIC-KEY"."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine reach the address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def endpoint(host: str, port: int) -> str:
    """Where a socket listens, in ZeroMQ's form; port 0 picks a free one."""
    return f"tcp://{f'[{host}]' if ':' in host else host}:{port or '*'}"


def split_key(address: str) -> tuple[str, bytes]:
    """The address without its public key, and the key; b"" if it has none."""
    where, _, key = address.partition(" ")
    return where, key.encode()
