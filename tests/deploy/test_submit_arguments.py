"""`deploy/submit.sh`: what it hands to Ray, and what it refuses. `echo` takes the place of Ray."""

from __future__ import annotations

import os
import subprocess

import pytest

from tests.end_to_end.commands import ROOT

DASHBOARD = "http://127.0.0.1:8265"
CONFIG = "experiments/miniwob_four.toml"
SUBMIT = f"job submit --address {DASHBOARD} --working-dir . -- giirl train"


def submit(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    env = {**{k: v for k, v in os.environ.items() if not k.startswith("RAY_")}, "RAY": "echo", **variables}
    command = [str(ROOT / "deploy/submit.sh"), *arguments]
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("variable", ["RAY_API_SERVER_ADDRESS", "RAY_ADDRESS"])
def test_a_run_is_submitted_to_the_dashboard_that_either_variable_names(variable: str) -> None:
    done = submit(CONFIG, "run=/shared/four", "--resume-or-start", **{variable: DASHBOARD})
    assert done.stdout == f"{SUBMIT} {CONFIG} run=/shared/four --resume-or-start runtime=ray\n"


def test_a_run_is_resumed_with_its_own_settings() -> None:
    done = submit("--resume", "/shared/four", "iterations=600", RAY_API_SERVER_ADDRESS=DASHBOARD)
    assert done.stdout == f"{SUBMIT} --resume /shared/four iterations=600\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "submit: no config given"),
        (("--resume",), "submit: --resume without a run"),
        (("no.toml",), "submit: there is no config no.toml"),
        ((CONFIG,), "submit: wanted the dashboard: export RAY_API_SERVER_ADDRESS="),
    ],
)
def test_a_mistake_is_one_line_that_says_what_is_wanted(arguments: tuple[str, ...], said: str) -> None:
    done = submit(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(said)
    assert done.stderr.count("\n") == 1
