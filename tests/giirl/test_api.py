"""Training, evaluating and loading a run from Python."""

from __future__ import annotations

import json
import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from giirl import LearnedReward, RunFolder, evaluate, load_policy, load_reward, read_episodes, train
from giirl.cli.main import giirl
from giirl.run.worlds import WORLDS
from giirl_core.nets.reward import SCHEMA
from giirl_core.types import Action, EpisodeSpec, Goal, Observation, Page, Trajectory, Verb
from tests.giirl.small import config
from tests.test_surface import WITHOUT, fresh


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A finished run."""
    settings = config(tmp_path_factory.mktemp("api") / "run")
    folder = RunFolder.create(settings, "test")
    train(settings, folder)
    return folder


@pytest.fixture(scope="module")
def exported(folder: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reward of the run in a file."""
    file = tmp_path_factory.mktemp("export") / "reward.safetensors"
    result = CliRunner().invoke(giirl, ["reward", "export", str(folder.path), str(file)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return file


def steps_of(trajectory: Trajectory) -> tuple[list[Page], list[Action], list[Goal]]:
    """Page, action and goal of each step."""
    return list(trajectory.pages), list(trajectory.actions), [trajectory.goal] * len(trajectory)


def test_training_writes_the_result_that_it_returns(folder: RunFolder) -> None:
    result = json.loads(folder.result.read_text())
    assert result["training_episodes"] == 4 * 8
    assert WORLDS["miniwob"].table(result).row_count == len(result["tasks"]) == 4


def test_evaluating_a_run_again_gives_the_same_result_and_takes_other_settings(folder: RunFolder) -> None:
    assert evaluate(folder.path)["tasks"] == json.loads(folder.result.read_text())["tasks"]
    more = evaluate(folder.path, ["evaluate.episodes=6"])
    assert {row["episodes"] for row in more["tasks"].values()} == {6}


def test_a_loaded_policy_acts_and_a_loaded_reward_scores_its_actions(folder: RunFolder) -> None:
    policy, reward = load_policy(folder.path), load_reward(folder.path)
    trajectory = read_episodes(folder.demonstrations)[0].trajectory
    [rewards] = reward.score([trajectory])
    assert rewards.shape == (len(trajectory),)
    assert np.all(np.isfinite(rewards))
    scored = reward.score_actions(trajectory.pages[0], trajectory.goal, [trajectory.actions[0]])
    assert scored[0] == pytest.approx(rewards[0], abs=1e-5)
    assert policy.greedy
    assert policy.version == 4
    assert not load_policy(folder.path, greedy=False).greedy


def test_training_that_fails_at_its_start_leaves_no_folder(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", "demos.source=file", f"demos.path={tmp_path / 'nowhere'}")
    with pytest.raises(OSError, match="nowhere"):
        train(settings, RunFolder.create(settings, "test"))
    assert not (tmp_path / "run").exists()


def test_a_grid_run_trains_and_evaluates_by_the_same_calls_and_has_no_reward_on_pages(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", "world=gridcraft", 'grid.goals=["red-blue"]', "grid.demonstrations=2")
    folder = RunFolder.create(settings, "test")
    result = train(settings, folder)
    assert evaluate(folder.path)["parameters_sha256"] == result["parameters_sha256"]
    assert WORLDS["gridcraft"].table(result).row_count == 1
    for load in (load_reward, load_policy):
        with pytest.raises(ValueError, match="which has no pages: wanted a run with world = 'miniwob'"):
            load(folder.path)


SCORES = """
import json
from pathlib import Path
from giirl import LearnedReward, read_episodes
reward, trajectory = LearnedReward(sys.argv[1]), read_episodes(Path(sys.argv[2]))[0].trajectory
goals = [trajectory.goal.utterance] * len(trajectory)
print(json.dumps([reward.version, reward.score_batch(trajectory.pages, trajectory.actions, goals).tolist()]))
"""


def test_an_exported_reward_scores_alike_in_a_process_without_its_run_chrome_and_ray(
    folder: RunFolder, exported: Path, tmp_path: Path
) -> None:
    demonstrations = shutil.copy(folder.demonstrations, tmp_path)
    missing = json.dumps(["ray", "selenium", "websocket", "zmq"])
    hidden = folder.path.rename(tmp_path / "moved")
    try:
        ended = fresh(WITHOUT + SCORES, missing, str(exported), str(demonstrations))
    finally:
        hidden.rename(folder.path)
    assert ended.returncode == 0, ended.stderr
    version, scores = json.loads(ended.stdout)
    reward, trajectory = LearnedReward(folder.path), read_episodes(folder.demonstrations)[0].trajectory
    assert version == reward.version == 4
    assert scores == pytest.approx(reward.score_batch(*steps_of(trajectory)).tolist(), abs=1e-5)
    assert scores == pytest.approx(load_reward(folder.path).score([trajectory])[0].tolist(), abs=1e-5)


def test_a_learned_reward_scores_one_action_several_and_batches_alike(folder: RunFolder, exported: Path) -> None:
    reward = LearnedReward(str(exported))
    trajectory = read_episodes(folder.demonstrations)[0].trajectory
    page, goal = trajectory.pages[0], trajectory.goal
    actions = [Action(verb=Verb.CLICK, element=row) for row in range(len(page))]
    together = reward.score_actions(page, actions, goal)
    seen = Observation(episode=EpisodeSpec(task=trajectory.task, seed=0), page=page, goal=goal)
    assert together.tolist() == pytest.approx([reward.score(seen, one, goal.utterance) for one in actions], abs=1e-5)
    many = 40 * len(actions)  # more than the net reads at a time
    batch = reward.score_batch([page] * many, actions * 40, [goal] * many)
    assert batch.tolist() == pytest.approx(together.tolist() * 40, abs=1e-5)
    assert reward.score_batch([], [], []).shape == (0,)
    with pytest.raises(ValueError, match="got 1 observations, 2 actions and 1 goals: wanted as many of each"):
        reward.score_batch([page], actions[:1] * 2, [goal])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (Action(verb=Verb.HOVER, element=0), "is none of the 2 gestures of the nets"),
        (Action(verb=Verb.CLICK, element=999), "is on element 999: wanted one of the"),
        (Action(verb=Verb.TYPE, element=0, start=0, end=999), "types tokens 0..999: the goal has"),
    ],
)
def test_an_action_without_a_reward_is_one_line(
    action: Action, message: str, folder: RunFolder, exported: Path
) -> None:
    trajectory = read_episodes(folder.demonstrations)[0].trajectory
    with pytest.raises(ValueError, match=message):
        LearnedReward(exported).score(trajectory.pages[0], action, trajectory.goal)


def with_header(blob: bytes, **changes: object) -> bytes:
    """An exported file with other values in the header of the reward."""
    size = struct.unpack("<Q", blob[:8])[0]
    head = json.loads(blob[8 : 8 + size])
    inner = {**json.loads(head["__metadata__"]["giirl_reward"]), **changes}
    head["__metadata__"]["giirl_reward"] = json.dumps(inner)
    text = json.dumps(head).encode()
    return struct.pack("<Q", len(text)) + text + blob[8 + size :]


def test_a_damaged_or_foreign_file_is_one_line(folder: RunFolder, exported: Path, tmp_path: Path) -> None:
    blob, file = exported.read_bytes(), tmp_path / "reward.safetensors"
    flipped = bytearray(blob)
    flipped[-1] ^= 1
    changed = [bytes(flipped), with_header(blob, clip=9.0), with_header(blob, version=5)]
    checkpoint = next(folder.checkpoints.glob("step-*/reward.safetensors")).read_bytes()
    net = json.loads(json.loads(blob[8 : 8 + struct.unpack("<Q", blob[:8])[0]])["__metadata__"]["giirl_reward"])["net"]
    cases = {
        "or it is damaged: ": [b"", b"text", blob[:-9], blob[: len(blob) // 2], b"\xff" * 64],
        "is damaged: its content has sha256": changed,
        "is no exported reward: wanted a file of `giirl reward export`": [checkpoint],
        f"its header has schema = 1.*reads schema {SCHEMA}": [with_header(blob, schema=1)],
        "its header has form = 'best'": [with_header(blob, form="best")],
        "its header has depth = 3": [with_header(blob, depth=3)],
        "needs the word vectors 'hashed' of version 9, here is version 1": [with_header(blob, vectors_version="9")],
        "its net has width 1000000": [with_header(blob, net={**net, "width": 1_000_000})],
        "is damaged: weights version 4: .* has shape": [with_header(blob, net={**net, "width": 8})],
    }
    for message, blobs in cases.items():
        for one in blobs:
            file.write_bytes(one)
            with pytest.raises(ValueError, match=message) as error:
                LearnedReward(file)
            assert str(file) in str(error.value)
            assert "\n" not in str(error.value)
    for position in np.random.default_rng(0).integers(len(blob) - 1, size=100).tolist() + list(range(0, 900, 9)):
        file.write_bytes(blob[:position] + bytes([blob[position] ^ 4]) + blob[position + 1 :])
        with pytest.raises(ValueError, match=re.escape(str(file))):
            LearnedReward(file)
    for path, message in ((tmp_path / "none", "there is no such file"), (tmp_path, "is not a run")):
        with pytest.raises(ValueError, match=message):
            LearnedReward(path)
