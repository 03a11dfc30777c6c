"""Errors that a farm raises before Chrome is started, and the decoding of page.js answers."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from browser_farm import pages
from browser_farm.experts import expert
from browser_farm.farm import ChromeFarm
from browser_farm.tasks import STATEFUL_TASKS, needs_fresh_document, page_url, tasks


@pytest.mark.parametrize("variable", ["GIIRL_CHROME", "GIIRL_CHROMEDRIVER"])
def test_a_missing_program_raises_a_one_line_error_that_says_what_to_install(
    variable: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program = tmp_path / "chrome"
    program.write_text("#!/bin/sh\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("GIIRL_CHROME", str(program))
    monkeypatch.setenv(variable, str(tmp_path / "nothing"))
    with pytest.raises(RuntimeError, match="apt-get install chromium chromium-driver") as caught:
        ChromeFarm(tabs=1)
    assert variable in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_chrome_on_the_path_the_error_lists_the_names_that_were_tried(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("GIIRL_CHROME", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"no Chrome on PATH .*chromium.*apt-get install"):
        ChromeFarm(tabs=1)


def test_the_error_for_an_unknown_task_names_the_nearest_task() -> None:
    with pytest.raises(ValueError, match="no MiniWoB task 'click-buton': did you mean 'click-button'"):
        page_url("click-buton")


def test_a_task_cannot_name_a_file_outside_the_page_folder() -> None:
    with pytest.raises(ValueError, match="no MiniWoB task"):
        page_url("../core/core")


def test_the_error_for_a_task_without_an_expert_names_the_nearest_task_with_one() -> None:
    with pytest.raises(ValueError, match="did you mean 'enter-text'"):
        expert("enter-txt")


def test_every_stateful_task_exists() -> None:
    assert set(tasks()) >= STATEFUL_TASKS
    assert not needs_fresh_document("click-button")


@pytest.mark.parametrize("wrong", [{"tabs": 0}, {"call_timeout_s": 0.0}, {"launch_timeout_s": float("nan")}])
def test_a_farm_rejects_numbers_out_of_range(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ChromeFarm(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["0", "null", "[1]", '[0,false,[["a"],[],[],[],[],[]],"Go."]', '[0,false,null,""]'])
def test_a_malformed_answer_raises_an_error(text: str) -> None:
    with pytest.raises((ValueError, TypeError)):
        pages.decode(json.loads(text))


def test_an_answer_is_decoded_into_a_page() -> None:
    strings = '["p","input_text"],["hi",""],["","x"],["a b",""]'
    numbers = '[1,-1,0,2,-1,3],[0,1,2,3,4,5,6,7.5],[1,"red","circle","name Your name"]'
    answer = pages.decode(json.loads(f'[0.5,true,[{strings},{numbers}],"Go on."]'))
    assert answer.page is not None
    assert answer.goal is not None
    assert (answer.raw_reward, answer.done, answer.goal.utterance) == (0.5, True, "Go on.")
    assert answer.page.tag == ("p", "input_text")
    assert answer.page.focused.tolist() == [False, True]
    assert answer.page.tampered.tolist() == [False, True]
    assert answer.page.box.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7.5]]
    assert (answer.page.colour, answer.page.shape) == (("", "red"), ("", "circle"))
    assert answer.page.attributes == ("", "name Your name")
