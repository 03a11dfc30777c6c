"""People in the loop: answers about episodes enter Algorithm 1 as demonstrations and as negatives.

    an episode that a person calls right           joins D_E, the demonstrations
    the right way that a person shows              joins D_E
    an episode relabelled with another instruction joins D_E under that instruction
    a wrong episode, from the marked step on       joins the negatives of the discriminator, `discriminator.feedback`

Nothing else changes: the loop samples from D_E and trains D_phi as before. At any time D_E and the negatives are what
the folder of answers holds, whatever the order in which the files came. So a resumed run continues with the same ones.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from giirl_core.config import Config
from giirl_core.files import explain
from giirl_core.gestures import read_gestures
from giirl_core.nets.language import Vectors
from giirl_core.types import is_held_out
from giirl_core.wire.answers import SUFFIX, Answer, read_answer
from learner.data import Example, Step, featurise_trajectory, steps_of

LOG = logging.getLogger(__name__)

Version = tuple[int, int, int]  # of a file: inode, time of change in ns, bytes


@dataclass(frozen=True, slots=True)
class Heard:
    """What the learner makes of the answers: demonstrations, and steps that are wrong."""

    demonstrations: tuple[Example, ...] = ()
    wrong: tuple[Step, ...] = ()


class Feedback:
    """The answers in a folder, which need not exist yet. A file that cannot be used is one warning, and left out."""

    def __init__(self, folder: Path, config: Config, vectors: Vectors) -> None:
        self._folder, self._config, self._vectors = folder, config, vectors
        self._gestures = read_gestures(config.net.gestures)
        self._files: dict[str, tuple[Version, Heard]] = {}

    def __len__(self) -> int:
        """The number of answers in use."""
        return sum(heard != Heard() for _, heard in self._files.values())

    def read(self) -> Heard | None:
        """All answers, ordered by the names of their files; None if nothing has changed since the last call."""
        versions = dict(sorted(self._versions()))
        if versions == {name: version for name, (version, _) in self._files.items()}:
            return None
        before, self._files = self._files, {}
        for name, version in versions.items():
            known = before.get(name)
            heard = known[1] if known is not None and known[0] == version else self._hear(self._folder / name)
            self._files[name] = version, heard
        all_heard = [heard for _, heard in self._files.values()]
        return Heard(
            tuple(example for heard in all_heard for example in heard.demonstrations),
            tuple(step for heard in all_heard for step in heard.wrong),
        )

    def _versions(self) -> list[tuple[str, Version]]:
        """The names and versions of the files of answers, in any order."""
        found = []
        for path in self._folder.glob(f"*{SUFFIX}"):
            with suppress(FileNotFoundError):  # it was removed just now
                stat = path.stat()
                found.append((path.name, (stat.st_ino, stat.st_mtime_ns, stat.st_size)))
        return found

    def _hear(self, path: Path) -> Heard:
        try:
            answer = read_answer(path)
            self._check(path, answer)
            played, *right = (
                featurise_trajectory(one, self._vectors, self._gestures)
                for one in (answer.episode, *answer.demonstrations)
            )
        except (ValueError, OSError) as error:
            LOG.warning("an answer is left out: %s", explain(error))
            return Heard()
        demonstrations, steps = tuple(right), steps_of([played])
        return Heard(demonstrations, tuple(steps[t] for t in answer.wrong_steps))

    def _check(self, path: Path, answer: Answer) -> None:
        """ValueError for an answer that this run must not learn from."""
        if answer.episode.task not in self._config.tasks:
            raise ValueError(f"{path} is about {answer.episode.task!r}, which is no task of this run")
        for goal in (answer.episode.goal, *(one.goal for one in answer.demonstrations)):
            if is_held_out(goal, self._config.held_out_goals):
                raise ValueError(f"{path} has the instruction {goal.utterance!r:.80}, which is held out of training")
