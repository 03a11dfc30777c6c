"""The limit on the open files of this process: the learner needs some for each actor."""

from __future__ import annotations

import resource

FILES = 512  # of a learner without actors: libraries, checkpoints, Ray
FILES_PER_ACTOR = 4  # 2.3 were measured
UNLIMITED = 1 << 30


def files_for(actors: int) -> int:
    """Open files that the learner of so many actors needs."""
    return FILES + FILES_PER_ACTOR * actors


def affordable_actors(files: int) -> int:
    """Actors that a learner with so many open files can have; below 0 if it can have none."""
    return (files - FILES) // FILES_PER_ACTOR


def open_files_limit() -> int:
    """Files that this process may open when it asks for it: the hard limit."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    return UNLIMITED if hard == resource.RLIM_INFINITY else hard


def raise_open_files(actors: int) -> None:
    """Raise the limit of this process to what so many actors need; ValueError if the machine allows fewer.

    At its limit a learner could not accept connections, and the actors would wait for ever.
    """
    wanted, most = files_for(actors), open_files_limit()
    if most < wanted:
        raise ValueError(
            f"this process may open {most} files, and {actors} actors need {wanted}: wanted ulimit -n {wanted}, "
            f"or at most {max(affordable_actors(most), 0)} actors (actors.count)"
        )
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
