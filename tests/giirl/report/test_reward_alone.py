"""The learned reward on its own: scoring episodes of a file, and serving the reward on a port or over HTTP."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from giirl.cli.main import giirl
from giirl.run.train import reward_of_run
from giirl_core.config_file import load_config
from giirl_core.nets.reward import build_reward
from giirl_core.wire.messages import read_episodes, write_episodes
from giirl_core.wire.score_client import ScoreClient
from reward_service.http_schema import ScoreRequest
from tests.giirl.small import run
from tests.learner.samples import expert_episodes

WAIT_S = 100.0


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("finished") / "run"
    run(path, "iterations=1")
    return path


def command(*words: str | Path) -> Result:
    return CliRunner().invoke(giirl, [str(word) for word in words])


@contextmanager
def serving(run: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run `giirl reward serve`; yields the process and the address that it prints."""
    words = [sys.executable, "-m", "giirl", "reward", "serve", str(run), *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        watchdog = threading.Timer(WAIT_S, process.kill)
        watchdog.start()
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()
            watchdog.cancel()


def test_every_step_of_every_episode_in_a_file_is_scored(finished: Path, tmp_path: Path) -> None:
    file, out = tmp_path / "some.giirl", tmp_path / "scores.json"
    episodes = expert_episodes(20)
    write_episodes(file, episodes)
    done = command("reward", "score", finished, file, "--json", out)
    assert done.exit_code == 0, done.exception
    scored = json.loads(out.read_text())
    model = build_reward(load_config(finished / "config.json"), reward_of_run(finished))
    assert [row["seed"] for row in scored["episodes"]] == [e.trajectory.seed for e in episodes]
    for row, episode in zip(scored["episodes"], episodes, strict=True):
        assert row["rewards"] == pytest.approx(model.score([episode.trajectory])[0].tolist(), abs=1e-3)
        assert row["return"] == pytest.approx(sum(row["rewards"]), abs=1e-3)
        assert row["success"]
    assert "enter-text" in done.output


def test_a_served_reward_answers_until_it_is_interrupted(finished: Path) -> None:
    trajectories = [episode.trajectory for episode in read_episodes(finished / "demonstrations.giirl")]
    with serving(finished) as (process, address):
        client = ScoreClient([address], identity="test", timeout_s=10.0)
        try:
            rewards, version = client.score(trajectories)
        finally:
            client.close()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=WAIT_S)
    model = build_reward(load_config(finished / "config.json"), reward_of_run(finished))
    assert version == 1
    assert address.startswith("127.0.0.1:")
    for got, wanted in zip(rewards, model.score(trajectories), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-4)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors


def test_an_exported_reward_is_served_over_http_until_it_is_interrupted(finished: Path, tmp_path: Path) -> None:
    exported = tmp_path / "reward.safetensors"
    assert command("reward", "export", finished, exported).exit_code == 0
    trajectory = read_episodes(finished / "demonstrations.giirl")[0].trajectory
    step = trajectory.pages[0], trajectory.goal, trajectory.actions[:1]
    sent = ScoreRequest.of(*step).model_dump_json(exclude_defaults=True).encode()
    with serving(exported, "--http") as (process, address):
        request = urllib.request.Request(f"{address}/score", sent, {"Content-Type": "application/json"})
        with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
            scores = json.load(answer)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=WAIT_S)
    assert address.startswith("http://127.0.0.1:")
    model = build_reward(load_config(finished / "config.json"), reward_of_run(finished))
    assert scores["rewards"] == pytest.approx(model.score_actions(*step).tolist(), abs=1e-4)
    assert (scores["version"], scores["best_first"]) == (1, [0])
    assert process.returncode == 0, errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["score", "RUN", "missing.giirl"], "missing.giirl"),
        (["score", "RUN", "notes.txt"], "notes.txt is not an episode file"),
        (["score", "nowhere", "notes.txt"], "nowhere is not a run"),
        (["serve", "nowhere"], "nowhere is not a run"),
        (["serve", "nowhere", "--http"], "nowhere is no exported reward: there is no such file"),
        (["serve", "RUN", "--host", "0.0.0.0"], "--host and --token-file are for --http"),
        (["serve", "RUN", "--http", "--host", "0.0.0.0"], "cannot listen on 0.0.0.0 without a token"),
        (["serve", "RUN", "--http", "--token-file", "notes.txt"], "the token has 4 characters: wanted 16 or more"),
        (["serve", "RUN", "--http", "--token-file", "missing"], "missing"),
        (["score", "CLONED", "notes.txt"], "learned no reward"),
        (["serve", "CLONED"], "learned no reward"),
    ],
)
def test_an_illegal_reward_command_is_an_error(
    words: list[str], message: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("dear")
    (tmp_path / "cloned").mkdir()
    settings = json.loads((finished / "config.json").read_text()) | {"algorithm": "cloning"}
    (tmp_path / "cloned/config.json").write_text(json.dumps(settings))
    paths = {"RUN": str(finished), "CLONED": "cloned"}
    done = command("reward", *(paths.get(word, word) for word in words))
    assert isinstance(done.exception, (ValueError, OSError))
    assert message in str(done.exception)
