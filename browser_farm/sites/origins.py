"""Origins: which addresses the pages of a task may reach."""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import urlsplit

SCHEMES = {"http": 80, "https": 443, "ws": 80, "wss": 443}
SOCKETS = {"http": "ws", "https": "wss"}


def is_http(address: str) -> bool:
    """Whether an address is on a server."""
    return address.startswith(("http://", "https://"))


def origin_of(address: str) -> str:
    """scheme://host:port of an address, without the port that its scheme has by default; "" if it has no host."""
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        return ""
    if parts.scheme not in SCHEMES or not parts.hostname:
        return ""
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{parts.scheme}://{host}" + (f":{port}" if port not in (None, SCHEMES[parts.scheme]) else "")


def proxy_bypass(origins: Iterable[str]) -> str:
    """Chrome's list of what does not go to the proxy: these origins, with their web sockets, and nothing else."""
    rules = ["<-loopback>"]  # Chrome would let loopback pass
    for origin in origins:
        parts = urlsplit(origin)
        host = f"[{parts.hostname}]" if parts.hostname and ":" in parts.hostname else parts.hostname
        port = parts.port or SCHEMES[parts.scheme]
        rules += [f"{scheme}://{host}:{port}" for scheme in (parts.scheme, SOCKETS[parts.scheme])]
    return ";".join(rules)


def resolver_rules(origins: Iterable[str]) -> str:
    """Chrome's rules for names: only the hosts of these origins and loopback are looked up."""
    hosts = sorted({"127.0.0.1", *(urlsplit(origin).hostname or "" for origin in origins)} - {""})
    return ", ".join(["MAP * ~NOTFOUND", *(f"EXCLUDE {host}" for host in hosts)])
