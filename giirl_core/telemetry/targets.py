"""The addresses of a run's metrics for Prometheus, as a file and over HTTP, and the removal of dead runs' addresses."""

from __future__ import annotations

import ipaddress
import json
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from giirl_core.files import folder_lock, write_json

TARGETS = "prometheus.json"  # in the folder of a run
UNROUTED = "192.0.2.1"  # an address for documentation: nothing is sent to it


def target_groups(run: str, targets: Mapping[str, str]) -> list[dict[str, Any]]:
    """The targets of one run as Prometheus's file and HTTP service discovery read them.

    `run` is the identity of the run; `targets` maps the name of a process to "host:port".
    """
    return [
        {
            "targets": [address],
            "labels": {"job": "giirl", "run": run, "process": process, "node": split_port(address)[0]},
        }
        for process, address in sorted(targets.items())
    ]


def write_targets(path: Path, groups: Sequence[Mapping[str, Any]]) -> None:
    """Write a service-discovery file (`file_sd`), atomically."""
    write_json(path, groups)


def clear_dead_targets(runs: Path) -> list[Path]:
    """Empty the targets of the runs in folder `runs` that no process works on any more; returns their folders.

    A run that was killed leaves its addresses, and another process may listen there by now.
    """
    cleared = []
    for path in sorted(runs.glob(f"*/{TARGETS}")):
        try:
            if json.loads(path.read_text(encoding="utf-8")):
                with folder_lock(path.parent):
                    write_targets(path, [])
                cleared.append(path.parent)
        except (OSError, ValueError):  # it runs, it is another user's, or it has just been removed
            continue
    return cleared


def join_port(host: str, port: int) -> str:
    """ "host:port", with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def reachable(address: str, node: str) -> str:
    """The "host:port" at which other machines reach a process that listens on `address` of the machine `node`."""
    host, port = split_port(address)
    return join_port(node, port) if _is_any(host) else address


def split_port(address: str) -> tuple[str, int]:
    """The inverse of `join_port`."""
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port)


def node_address() -> str:
    """The address of this machine that other machines reach; loopback where there is no network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((UNROUTED, 9))
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])


def _is_any(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
