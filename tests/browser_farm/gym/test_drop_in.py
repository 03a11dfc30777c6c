"""What a program written for the miniwob package's environment relies on, in ours: real Chrome, both kinds of time."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
import pytest

from browser_farm.farm import ChromeFarm
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from browser_farm.tasks import pages_directory
from giirl_core.types import Command, EpisodeSpec, Verb

pytestmark = pytest.mark.chrome

ATTENTION_PIXEL = "String(core.attentionCtx ? core.attentionCtx.getImageData(4, 54, 1, 1).data : 'no drawing')"


@pytest.fixture(scope="module")
def env() -> Iterator[MiniWoB]:
    made = MiniWoB("enter-text", wait_ms=300)
    yield made
    made.close()


@pytest.fixture(scope="module")
def trusted() -> Iterator[MiniWoB]:
    made = MiniWoB("enter-text", trusted=True)
    yield made
    made.close()


@pytest.fixture(scope="module")
def real_time() -> Iterator[MiniWoB]:
    made = MiniWoB(subdomain="click-test", real_time=True, wait_ms=20)
    yield made
    made.close()


def click(env: MiniWoB, observation: dict[str, Any], tag: str) -> dict[str, Any]:
    return env.create_action(
        "CLICK_ELEMENT", ref=next(e["ref"] for e in observation["dom_elements"] if e["tag"] == tag)
    )


def value(observation: dict[str, Any]) -> str:
    return str(next(e["value"] for e in observation["dom_elements"] if e["tag"] == "input_text"))


@pytest.mark.parametrize("name", ["env", "trusted"])
@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("ab\ue012c", "acb"),  # arrow left
        ("abc\ue003", "ab"),  # backspace
        ("ab\ue011\ue017c", "cb"),  # home, delete
        ("a\ue009b\ue01b", "ab1"),  # a modifier is released before the next character; digit of the number pad
        ("a\ue002\ue000b", "ab"),  # keys without an effect
    ],
)
def test_special_keys_in_typed_text_act_as_keys(
    name: str, typed: str, wanted: str, request: pytest.FixtureRequest
) -> None:
    env: MiniWoB = request.getfixturevalue(name)
    observation, _ = env.reset(seed=3)
    env.step(click(env, observation, "input_text"))
    assert value(env.step(env.create_action("TYPE_TEXT", text=typed))[0]) == wanted


@pytest.mark.parametrize("name", ["env", "trusted"])
def test_a_tab_in_typed_text_moves_the_focus_for_what_follows(name: str, request: pytest.FixtureRequest) -> None:
    env: MiniWoB = request.getfixturevalue(name)
    observation, _ = env.reset(seed=3)
    field = next(e["ref"] for e in observation["dom_elements"] if e["tag"] == "input_text")
    action = env.create_action("FOCUS_ELEMENT_AND_TYPE_TEXT", ref=field, text="ab\ue004\ue00d")
    _, _, terminated, _, info = env.step(action)  # the space presses Submit
    assert (terminated, info["raw_reward"]) == (True, -1.0)


def test_the_wait_after_an_action_is_time_of_the_page(env: MiniWoB) -> None:
    env.reset(seed=3)
    before, _, after = (env._farm.run_script(0, "String(performance.now())"), env.step(None), None)
    after = env._farm.run_script(0, "String(performance.now())")
    assert float(after or 0) - float(before or 0) == 100 + 300


def test_attention_is_drawn_until_it_is_cleared_or_the_page_changes(env: MiniWoB) -> None:
    env.reset(seed=3)
    env.visualize_attention(None)
    assert env._farm.run_script(0, ATTENTION_PIXEL) == "no drawing"
    env.visualize_attention(np.full((20, 20), 0.5))
    assert env._farm.run_script(0, ATTENTION_PIXEL) in ("127,127,127,255", "128,128,128,255")
    assert any(element["id"] == "attention-canvas" for element in env.step(None)[0]["dom_elements"])
    env.visualize_attention(np.zeros((0, 0)))
    assert env._farm.run_script(0, ATTENTION_PIXEL) == "0,0,0,0"
    observation, _ = env.reset(seed=3)
    assert not any(element["id"] == "attention-canvas" for element in observation["dom_elements"])
    with pytest.raises(ValueError, match=r"shape \(21, 3\): wanted rows and columns, at most 20 x 20"):
        env.visualize_attention(np.zeros((21, 3)))


def test_each_seed_beyond_the_exact_numbers_of_javascript_has_its_own_page() -> None:
    seeds: list[SupportsIndex] = [2**53, 2**53 + 1, 2**53 + 2, 2**70, 2**70 + 1, np.uint64(2**63 + 5)]
    env = MiniWoB("click-checkboxes-large")
    try:
        shown = [env.reset(seed=seed)[0]["utterance"] for seed in seeds]
        assert len(set(shown)) == len(seeds)
        assert env.reset(seed=np.int64(2**53 + 1))[0]["utterance"] == shown[1]
    finally:
        env.close()


# ---- in real time


def test_in_real_time_the_page_has_its_clock_its_scaled_reward_and_screenshots(real_time: MiniWoB) -> None:
    observation, info = real_time.reset(seed=4)
    assert observation["screenshot"].any()
    assert "elapsed" not in info
    assert int(real_time._farm.run_script(0, "String(Date.now())") or 0) > 1_750_000_000_000  # later than virtual time
    before = float(real_time._farm.run_script(0, "String(performance.now())") or 0)
    assert real_time.step(None)[1:4] == (0.0, False, False)
    assert float(real_time._farm.run_script(0, "String(performance.now())") or 0) - before >= 20
    observation, reward, terminated, _, info = real_time.step(click(real_time, observation, "button"))
    assert terminated
    assert (info["raw_reward"], info["env_reward"]) == (1.0, reward)
    assert 0 < reward < 1
    assert info["elapsed"] > 0
    assert not observation["screenshot"].any()


def test_in_real_time_an_episode_ends_with_the_time_limit_of_the_page(real_time: MiniWoB) -> None:
    real_time.reset(seed=4)
    real_time._farm.run_script(0, "core.EPISODE_MAX_TIME = 1;''")
    real_time.reset(seed=4)
    real_time._farm.run_script(0, "core.EPISODE_MAX_TIME = 10000;''")
    action = real_time.create_action("CLICK_ELEMENT", ref=1)
    _, reward, terminated, truncated, info = real_time.step(action)
    assert (reward, terminated, truncated, info["reason"]) == (-1.0, True, False, "timed out")


def test_in_real_time_every_page_of_a_vector_draws_its_frames() -> None:
    envs = MiniWoBVector(["click-pie-nodelay", "click-test"], 4, real_time=True, wait_ms=300)
    try:
        observation, _ = envs.reset(seed=4)
        assert all(image.any() for image in observation["screenshot"])
        count = (
            "let frames = 0; const draw = () => { frames += 1; window.frames_ = frames; requestAnimationFrame(draw); };"
        )
        for index in range(4):
            envs._farm.run_script(index, f"{{ {count} draw(); }}''")
        envs.step([None] * 4)
        assert all(int(envs._farm.run_script(index, "String(frames_)") or 0) > 2 for index in range(4))
        buttons = [next((e["ref"] for e in page if e["tag"] == "button"), 0) for page in observation["dom_elements"]]
        kinds = [{"action_type": 8, "ref": ref} if ref else None for ref in buttons]
        _, rewards, terminated, _, infos = envs.step(kinds)
        assert list(terminated) == [False, True, False, True]
        assert all(0 < rewards[index] < 1 == infos["raw_reward"][index] for index in (1, 3))
        assert not envs.step([None] * 4)[2].any()
    finally:
        envs.close()


# ---- where pages come from, and when they are loaded anew


def test_pages_can_come_from_another_folder_and_from_a_server(env: MiniWoB) -> None:
    expected, _ = env.reset(seed=6)
    quiet = type("Quiet", (SimpleHTTPRequestHandler,), {"log_message": lambda *_: None})
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(quiet, directory=str(pages_directory())))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        for base_url in (
            f"http://127.0.0.1:{server.server_port}/miniwob/",
            (pages_directory() / "miniwob").as_uri() + "/",
        ):
            other = MiniWoB("enter-text", base_url=base_url)
            try:
                observation, _ = other.reset(seed=6)
                assert [e["text"] for e in observation["dom_elements"]] == [e["text"] for e in expected["dom_elements"]]
                assert observation["utterance"] == expected["utterance"]
                assert str(other._farm.run_script(0, "location.href")).startswith(base_url)
            finally:
                other.close()
    finally:
        server.shutdown()
        server.server_close()


def test_a_page_that_never_opens_costs_its_own_episode_only(tmp_path: Path) -> None:
    for folder in ("core", "common"):
        (tmp_path / folder).symlink_to(pages_directory() / folder)
    (tmp_path / "miniwob").mkdir()
    page = (pages_directory() / "miniwob/click-test-2.html").read_text()
    (tmp_path / "miniwob/click-test-2.html").write_text(page)
    broken = page.replace("var genProblem = function() {", "var genProblem = function() { throw new Error('broken');")
    assert broken != page
    (tmp_path / "miniwob/click-test.html").write_text(broken)
    closed, sound = (EpisodeSpec(task=task, seed=3) for task in ("click-test", "click-test-2"))
    with ChromeFarm(tabs=2, base_url=(tmp_path / "miniwob").as_uri() + "/") as farm:
        opened = farm.reset({0: closed, 1: sound})
        assert list(opened) == [1]
        assert "click-test with seed 3 does not open after 4 attempts: page_error" in farm.unopened[0]
        result = farm.step({1: Command(verb=Verb.WAIT, last=True, following=closed)})[1]
        assert (result.observation, result.lost, list(farm.unopened)) == (None, "", [1])
        assert list(farm.reset({0: sound, 1: sound})) == [0, 1]
        assert farm.unopened == {}


def test_a_page_is_loaded_anew_every_so_many_episodes() -> None:
    env = MiniWoB("click-test", refresh_freq=2)
    try:
        kept = []
        for _ in range(4):
            env.reset(seed=3)
            kept.append(env._farm.run_script(0, "String(Boolean(window.marked))"))
            env._farm.run_script(0, "window.marked = true;''")
        assert kept == ["false", "false", "true", "false"]
    finally:
        env.close()
