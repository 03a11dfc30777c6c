"""The image of a node: built here from Debian packages, it trains with its own Chrome as another user than root."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.deploy.test_kubernetes import job, pods
from tests.end_to_end.commands import ROOT

BUILD = ROOT / "deploy/image/build.sh"
NAME = "localhost/giirl-of-the-tests"
TRAIN = (
    *("giirl", "train", "runtime=local", 'tasks=["click-test-2"]', "iterations=3", "rollout_batch=4"),
    *("net.vectors=hashed", "demos.per_task=4", "evaluate.episodes=4", "evaluate.random_episodes=4"),
)


def buildah(*arguments: str, timeout_s: float = 300) -> str:
    done = subprocess.run(
        ["buildah", *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def container(full: bool) -> Iterator[str]:
    """A container of the freshly built image."""
    if not full:
        pytest.skip("takes many minutes: `pytest tests/deploy` runs it, and so does .ci/run")
    if os.geteuid() or not shutil.which("buildah") or not shutil.which("mmdebstrap"):
        pytest.skip("needs root, buildah and mmdebstrap: apt-get install buildah mmdebstrap crun")
    done = subprocess.run([BUILD, NAME], cwd=ROOT, capture_output=True, text=True, timeout=1500, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    made = buildah("from", "--pull-never", NAME).strip()
    yield made
    buildah("rm", made)
    buildah("rmi", NAME)


def inside(container: str, *command: str, timeout_s: float = 300, **variables: str) -> str:
    """Run a command in the container as the user of the image."""
    settings = [word for name, value in variables.items() for word in ("--env", f"{name}={value}")]
    return buildah("run", "--isolation=chroot", *settings, container, "--", *command, timeout_s=timeout_s)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_image_has_its_user_its_health_check_and_a_first_process(container: str) -> None:
    config: dict[str, Any] = json.loads(buildah("inspect", "--type", "image", NAME))["Docker"]["config"]
    assert config["User"] == "1000:1000"
    assert config["Healthcheck"]["Test"] == ["CMD-SHELL", "giirl-healthy"] or "giirl-healthy" in str(
        config["Healthcheck"]
    )
    assert config["Entrypoint"] == ["tini", "--"]
    assert inside(container, "id", "-un").strip() == "giirl"
    inside(container, "giirl-healthy")  # no process serves metrics, as on a node that waits


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_short_training_runs_in_the_image_with_its_own_chrome(container: str) -> None:
    assert "MISSING" not in inside(container, "giirl", "doctor", GIIRL_CHROME_SANDBOX="off")
    inside(container, *TRAIN, "run=/runs/short", timeout_s=600, GIIRL_CHROME_SANDBOX="off")
    result = json.loads(inside(container, "cat", "/runs/short/result.json"))
    assert result["tasks"]["click-test-2"]["episodes"] == 4


def test_pods_run_as_the_user_of_the_image_and_find_the_experiments() -> None:
    text = BUILD.read_text()
    user = re.search(r"useradd --uid (\d+)", text)
    assert user
    assert {template["spec"]["securityContext"]["runAsUser"] for _, template in pods()} == {int(user.group(1))}
    assert 'cp -r experiments "$root/opt/giirl/"' in text
    assert job()[0][2].startswith("/opt/giirl/experiments/")
    assert job()[1].metrics.port == int(re.findall(r"--port (\d+)", text)[0])
