"""Spoiled messages and files without end: only the documented errors come of them, and memory does not grow.

python -m tests.chaos.fuzz FOLDER MESSAGES FILES writes FOLDER/fuzz.json. Half of the messages have their checksum
mended after they were spoiled, and checkpoint files stand under a manifest that agrees with them, so that what lies
behind checksums is reached too.
"""

from __future__ import annotations

import gzip
import json
import logging
import random
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from browser_farm.human.recordings import read_recording
from giirl_core.config_file import load_config
from giirl_core.metrics import Metrics
from giirl_core.wire import delivery, scoring
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, Notice
from giirl_core.wire.messages import ALIGN, LENGTH, PADDING, PREFIX, WireError
from learner.learner import Learner
from learner.stream.admission import Admission, IngestLimits
from learner.stream.snapshot import BOOKS, QUEUE, ActorOffsets, IngestSnapshot
from tests.giirl.small import config
from tests.giirl_core.wire_examples import STAMP, episode

WORDS = [b"\x00", b"\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"\x80", b"\xc0", b"\xdd\xff\xff\xff\xff", b"{}"]
RECORDING = {
    "taskName": "click-test",
    "utterance": "Click the button.",
    "states": [
        {"time": 0, "action": None, "dom": {"tag": "BODY", "children": [{"tag": "BUTTON", "text": "Ok", "ref": 1}]}},
        {"time": 9, "action": {"type": "click", "timing": 1, "x": 3, "y": 4}, "dom": {"tag": "BODY", "children": []}},
    ],
    "rawReward": 1,
    "reward": 0.9,
}


def spoil(rng: random.Random, data: bytes) -> bytes:
    """A few bytes changed, cut, doubled, put in or moved."""
    spoiled = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        place, end = rng.randrange(len(spoiled) + 1), rng.randrange(len(spoiled) + 1)
        match rng.randrange(6):
            case 0 if spoiled:
                spoiled[place % len(spoiled)] ^= 1 << rng.randrange(8)
            case 1 if spoiled:
                spoiled[place % len(spoiled)] = rng.randrange(256)
            case 2:
                del spoiled[place:end]
            case 3:
                spoiled[place:place] = spoiled[place : place + 16]
            case 4:
                spoiled[place:place] = rng.choice(WORDS)
            case _:
                word = rng.choice(WORDS)
                spoiled[place : place + len(word)] = word
    return bytes(spoiled)


def spoil_message(rng: random.Random, message: bytes) -> bytes:
    """Anywhere, or in the header alone, whose length is mended then; half have a checksum that suits, too."""
    if rng.random() < 0.5:
        spoiled = spoil(rng, message)
    else:
        start = PREFIX.size + LENGTH.size
        end = start + LENGTH.unpack_from(message, PREFIX.size)[0]
        header = spoil(rng, message[start:end])
        columns = message[end + -end % ALIGN :]
        spoiled = b"".join(
            [message[: PREFIX.size], LENGTH.pack(len(header)), header, PADDING[len(header) % ALIGN], columns]
        )
    if len(spoiled) >= PREFIX.size and rng.random() < 0.5:
        magic, schema, _ = PREFIX.unpack_from(spoiled)
        rest = spoiled[PREFIX.size :]
        spoiled = PREFIX.pack(magic, schema, wire.checksum(rest)) + rest
    return spoiled


def messages() -> list[tuple[bytes, Callable[[bytes], object]]]:
    """Every kind there is, and who reads it."""
    notice = Notice(kind=delivery.HELLO, stamp=STAMP, number=3, finished=50, before=((0, 5), (1, 2)))
    grant = Grant(incarnation=2, notice=3, low_watermark=4, acked=(6, 9), committed=1, settled=1, limit=12)
    books = Admission(
        STAMP.run,
        lambda: 3,
        reward_version=None,
        limits=IngestLimits(credits=4, max_bytes=1 << 20),
        metrics=Metrics(),
        held=IngestSnapshot(),
    )
    reply = scoring.ScoreReply(request=1, rewards=(np.ones(2, np.float32),), version=3, backlog=2)
    whole = wire.encode_episode(episode(2), stamp=STAMP)

    def hear(message: bytes) -> None:
        books.receive(b"peer", message)
        books.grants()
        books.pull(1)

    def ask(message: bytes) -> None:
        scoring.build_request(*wire.decode(message))

    return [
        (whole, wire.decode_episode),
        (whole, hear),
        (delivery.encode_notice(notice), hear),
        (delivery.encode_grant(grant), lambda message: delivery.read_grant(wire.decode(message)[0])),
        (scoring.encode_request(1, [episode(2).trajectory, episode(1).trajectory]), ask),
        (scoring.encode_reply(reply), scoring.decode_reply),
    ]


def files(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    """Every kind of file that a run reads, and who reads it."""
    demos = folder / "demos.giirl"
    wire.write_episodes(demos, [episode(n, seed=n) for n in (1, 2)])
    recording, packed = folder / "recording.json", folder / "recording.json.gz"
    recording.write_text(json.dumps(RECORDING))
    packed.write_bytes(gzip.compress(recording.read_bytes()))
    checkpoint = folder / "checkpoint"
    checkpoint.mkdir()
    settings = config(folder / "run")
    learner = Learner(settings, [replace(episode(2).trajectory, policy_version=-1)], Metrics())
    learner.save(checkpoint)
    held = IngestSnapshot(
        episodes=(episode(1),),
        marks=(ActorOffsets(actor="a", incarnation=1, low_watermark=2, acked=(4,)),),
        counts={"lost": 1},
    )
    held.save(checkpoint)
    toml, saved = folder / "config.toml", folder / "config.json"
    toml.write_text('seed = 3\ntasks = ["click-test"]\n[policy]\nentropy = 0.2\n[actors]\ncount = 2\n')
    saved.write_text(json.dumps({"seed": 3, "tasks": ["click-test"], "policy": {"entropy": 0.2}}))
    read: list[tuple[Path, Callable[[Path], object]]] = [
        (demos, wire.read_episodes),
        (recording, read_recording),
        (packed, read_recording),
        (toml, load_config),
        (saved, load_config),
        (checkpoint / BOOKS, lambda path: IngestSnapshot.load(path.parent)),
        (checkpoint / QUEUE, lambda path: IngestSnapshot.load(path.parent)),
    ]
    for name in ("learner.json", "policy.safetensors", "reward_optimiser.safetensors", "replay.giirl"):
        read.append((checkpoint / name, lambda path: learner.load(path.parent)))
    return read


def fuzz_messages(rng: random.Random, count: int) -> Counter[str]:
    known = messages()
    found: Counter[str] = Counter()
    for _ in range(count):
        message, read = rng.choice(known)
        try:
            read(spoil_message(rng, message))
            found["read"] += 1
        except WireError:
            found["WireError"] += 1
        except Exception as error:  # noqa: BLE001 - what is looked for
            found[f"{type(error).__name__}: {error!s:.200}"] += 1
    return found


def fuzz_files(rng: random.Random, folder: Path, count: int) -> Counter[str]:
    known = [(path, path.read_bytes(), read) for path, read in files(folder)]
    found: Counter[str] = Counter()
    for _ in range(count):
        path, whole, read = rng.choice(known)
        path.write_bytes(spoil(rng, whole))
        try:
            read(path)
            found["read"] += 1
        except ValueError as error:
            found["ValueError" if str(error) else f"{path.name}: an error without a word"] += 1
        except Exception as error:  # noqa: BLE001 - what is looked for
            found[f"{path.name}: {type(error).__name__}: {error!s:.200}"] += 1
        path.write_bytes(whole)
    return found


def main() -> None:
    folder, sent, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    logging.disable(logging.WARNING)
    rng, since_s = random.Random(5), time.monotonic()
    seen = {"messages": fuzz_messages(rng, sent // 4)}
    before = psutil.Process().memory_info().rss
    seen["messages"] += fuzz_messages(rng, sent - sent // 4)
    growth = (psutil.Process().memory_info().rss - before) / 2**20
    seen["files"] = fuzz_files(rng, folder, count)
    told = {name: dict(found) for name, found in seen.items()}
    result = {**told, "growth_mib": round(growth, 1), "seconds": round(time.monotonic() - since_s, 1)}
    (folder / "fuzz.json").write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
