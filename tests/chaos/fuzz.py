"""Fuzzing: corrupt messages and files raise only the documented errors, and memory does not grow.

python -m tests.chaos.fuzz FOLDER MESSAGES FILES writes FOLDER/fuzz.json. Half of the corrupt messages get a
valid checksum, and checkpoint files are read without their manifest, so that the code behind the checksums is reached,
too.
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
from learner.stream.admission import Admission
from learner.stream.flow import IngestLimits
from learner.stream.snapshot import OFFSETS_FILE, QUEUE_FILE, ActorOffsets, IngestSnapshot
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


def corrupt(rng: random.Random, data: bytes) -> bytes:
    """Flip, overwrite, delete, duplicate or insert bytes at one place or a few."""
    corrupted = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        start, end = rng.randrange(len(corrupted) + 1), rng.randrange(len(corrupted) + 1)
        match rng.randrange(6):
            case 0 if corrupted:
                corrupted[start % len(corrupted)] ^= 1 << rng.randrange(8)
            case 1 if corrupted:
                corrupted[start % len(corrupted)] = rng.randrange(256)
            case 2:
                del corrupted[start:end]
            case 3:
                corrupted[start:start] = corrupted[start : start + 16]
            case 4:
                corrupted[start:start] = rng.choice(WORDS)
            case _:
                word = rng.choice(WORDS)
                corrupted[start : start + len(word)] = word
    return bytes(corrupted)


def corrupt_message(rng: random.Random, message: bytes) -> bytes:
    """Corrupt any bytes, or only the header and adjust its length; half of the results get a valid checksum."""
    if rng.random() < 0.5:
        corrupted = corrupt(rng, message)
    else:
        start = PREFIX.size + LENGTH.size
        end = start + LENGTH.unpack_from(message, PREFIX.size)[0]
        header = corrupt(rng, message[start:end])
        columns = message[end + -end % ALIGN :]
        corrupted = b"".join(
            [message[: PREFIX.size], LENGTH.pack(len(header)), header, PADDING[len(header) % ALIGN], columns]
        )
    if len(corrupted) >= PREFIX.size and rng.random() < 0.5:
        magic, schema, _ = PREFIX.unpack_from(corrupted)
        rest = corrupted[PREFIX.size :]
        corrupted = PREFIX.pack(magic, schema, wire.checksum(rest)) + rest
    return corrupted


def messages() -> list[tuple[bytes, Callable[[bytes], object]]]:
    """A valid message of each kind, with a function that reads it."""
    notice = Notice(kind=delivery.HELLO, stamp=STAMP, number=3, finished=50, before=((0, 5), (1, 2)))
    grant = Grant(incarnation=2, notice=3, low_watermark=4, acked=(6, 9), committed=1, settled=1, limit=12)
    admission = Admission(
        STAMP.run,
        lambda: 3,
        reward_version=None,
        limits=IngestLimits(credits=4, max_bytes=1 << 20),
        metrics=Metrics(),
        snapshot=IngestSnapshot(),
    )
    reply = scoring.ScoreReply(request=1, rewards=(np.ones(2, np.float32),), version=3, backlog=2)
    encoded = wire.encode_episode(episode(2), stamp=STAMP)

    def admit(message: bytes) -> None:
        admission.receive(b"peer", message)
        admission.grants()
        admission.pull(1)

    def build_request(message: bytes) -> None:
        scoring.build_request(*wire.decode(message))

    return [
        (encoded, wire.decode_episode),
        (encoded, admit),
        (delivery.encode_notice(notice), admit),
        (delivery.encode_grant(grant), lambda message: delivery.read_grant(wire.decode(message)[0])),
        (scoring.encode_request(1, [episode(2).trajectory, episode(1).trajectory]), build_request),
        (scoring.encode_reply(reply), scoring.decode_reply),
    ]


def files(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    """A valid file of each kind that a run reads, with a function that reads it."""
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
    snapshot = IngestSnapshot(
        episodes=(episode(1),),
        offsets=(ActorOffsets(actor="a", incarnation=1, low_watermark=2, acked=(4,)),),
        counts={"lost": 1},
    )
    snapshot.save(checkpoint)
    toml, saved = folder / "config.toml", folder / "config.json"
    toml.write_text('seed = 3\ntasks = ["click-test"]\n[policy]\nentropy = 0.2\n[actors]\ncount = 2\n')
    saved.write_text(json.dumps({"seed": 3, "tasks": ["click-test"], "policy": {"entropy": 0.2}}))
    readers: list[tuple[Path, Callable[[Path], object]]] = [
        (demos, wire.read_episodes),
        (recording, read_recording),
        (packed, read_recording),
        (toml, load_config),
        (saved, load_config),
        (checkpoint / OFFSETS_FILE, lambda path: IngestSnapshot.load(path.parent)),
        (checkpoint / QUEUE_FILE, lambda path: IngestSnapshot.load(path.parent)),
    ]
    for name in ("learner.json", "policy.safetensors", "reward_optimiser.safetensors", "replay.giirl"):
        readers.append((checkpoint / name, lambda path: learner.load(path.parent)))
    return readers


def fuzz_messages(rng: random.Random, count: int) -> Counter[str]:
    examples = messages()
    outcomes: Counter[str] = Counter()
    for _ in range(count):
        message, read = rng.choice(examples)
        try:
            read(corrupt_message(rng, message))
            outcomes["read"] += 1
        except WireError:
            outcomes["WireError"] += 1
        except Exception as error:  # noqa: BLE001 - any other error is a finding
            outcomes[f"{type(error).__name__}: {error!s:.200}"] += 1
    return outcomes


def fuzz_files(rng: random.Random, folder: Path, count: int) -> Counter[str]:
    examples = [(path, path.read_bytes(), read) for path, read in files(folder)]
    outcomes: Counter[str] = Counter()
    for _ in range(count):
        path, original, read = rng.choice(examples)
        path.write_bytes(corrupt(rng, original))
        try:
            read(path)
            outcomes["read"] += 1
        except ValueError as error:
            outcomes["ValueError" if str(error) else f"{path.name}: an error without a message"] += 1
        except Exception as error:  # noqa: BLE001 - any other error is a finding
            outcomes[f"{path.name}: {type(error).__name__}: {error!s:.200}"] += 1
        path.write_bytes(original)
    return outcomes


def main() -> None:
    folder, message_count, file_count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    logging.disable(logging.WARNING)
    rng, started_s = random.Random(5), time.monotonic()
    outcomes = {"messages": fuzz_messages(rng, message_count // 4)}  # also a warm-up for the measurement of memory
    before = psutil.Process().memory_info().rss
    outcomes["messages"] += fuzz_messages(rng, message_count - message_count // 4)
    growth = (psutil.Process().memory_info().rss - before) / 2**20
    outcomes["files"] = fuzz_files(rng, folder, file_count)
    result = {
        **{name: dict(counts) for name, counts in outcomes.items()},
        "growth_mib": round(growth, 1),
        "seconds": round(time.monotonic() - started_s, 1),
    }
    (folder / "fuzz.json").write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
