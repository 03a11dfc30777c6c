"""What is stored in place of a password that a person typed."""

from __future__ import annotations

import numpy as np
import pytest

from browser_farm.human.passwords import MASK, Passwords, Recorded
from browser_farm.human.steps import Step
from browser_farm.sites.fields import resolve
from giirl_core.types import Goal, Page, Verb

GOAL = Goal('Log in as "ada" with the password "lace".')


def page(*fields: tuple[str, str, str]) -> Page:
    """A page of rows with this tag, text and value."""
    count = len(fields)
    tag, text, value = zip(*fields, strict=True)
    return Page(
        tag=tag,
        text=text,
        value=value,
        classes=("",) * count,
        ref=np.arange(1, count + 1, dtype=np.int32),
        parent=np.full(count, -1, dtype=np.int16),
        box=np.zeros((count, 4), dtype=np.float32),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.zeros(count, dtype=np.bool_),
    )


def typing(text: str, before: str = "", *, beside: str = "", password: bool = True) -> Recorded:
    """Typing into a password field that held `before`, with a text beside it."""
    shown = page(("input_password", "Password", before), ("p", beside, ""))
    step = Step(page=shown, verb=Verb.TYPE, ref=1, text=text, at=(0.0, 0.0), by=(0.0, 0.0))
    return Recorded(step=step, hidden=(0,), is_password=password)


def stored(recorded: list[Recorded], **values: str) -> list[Step]:
    return Passwords({}).hide(recorded, GOAL, values)


def test_a_password_of_the_instruction_stays_because_its_words_are_typed_from_there() -> None:
    (step,) = stored([typing("lace", before="lace")])
    assert (step.text, step.page.value[0]) == ("lace", "lace")


def test_the_value_of_a_field_of_the_task_file_becomes_a_reference_to_it() -> None:
    first, second = stored([typing("swordfish"), typing("swordfish", before="swordfish")], code="swordfish")
    assert first.text == "{code}"
    assert second.page.value[0] == "{code}"


def test_any_other_password_becomes_a_variable_the_same_for_the_same_password() -> None:
    passwords = Passwords({"GIIRL_PASSWORD": "swordfish", "HOME": "hunter2hunter2"})
    typed = [typing("swordfish"), typing("hunter2hunter2"), typing("swordfish")]
    steps = passwords.hide(typed, GOAL, {"seed": "swordfish"})
    assert [step.text for step in steps] == ["{env:GIIRL_PASSWORD}", "{env:GIIRL_PASSWORD_2}", "{env:GIIRL_PASSWORD}"]
    assert passwords.unset == ["GIIRL_PASSWORD_2"]
    (later,) = passwords.hide([typing("hunter2hunter2")], GOAL, {})
    assert later.text == "{env:GIIRL_PASSWORD_2}"


@pytest.mark.parametrize("password", ["correct horse", "a{2}$&", "x", "käse•" * 60])
def test_a_password_is_nowhere_in_clear_however_it_is_shown(password: str) -> None:
    shown = [typing(password), typing("next", before=password[: len(password) // 2 + 1])]
    shown += [typing(f"is {password}" if len(password) > 3 else password, beside=password, password=False)]
    shown += [typing(password, before=password)]
    for step in stored(shown):
        texts = [step.text, *step.page.text, *step.page.value, *step.page.classes, *step.page.attributes]
        assert all(password not in text or (len(password) == 1 and text != password) for text in texts), texts
        assert all(" ".join(password.split())[:200] != text for text in texts)


def test_a_password_that_begins_with_another_is_hidden_as_a_whole() -> None:
    steps = stored([typing("horse"), typing("horse battery", before="horse", beside="horse battery")])
    assert steps[1].page.text[1] == "{env:GIIRL_PASSWORD_2}"
    assert "battery" not in str(steps)


def test_what_a_password_field_held_on_the_way_is_masked() -> None:
    assert [step.page.value[0] for step in stored([typing("swordfish", before="swor")])] == [MASK]


def test_the_rest_of_a_page_stays_as_it_was() -> None:
    before = typing("swordfish", beside="Forgot it?")
    (after,) = stored([before])
    assert after.page.text == before.step.page.text
    assert after.page.ref is before.step.page.ref


def test_a_reference_is_resolved_and_other_text_stands_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIIRL_PASSWORD", "swordfish")
    assert resolve("{env:GIIRL_PASSWORD}", {}) == "swordfish"
    assert resolve("{code}", {"code": "lace"}) == "lace"
    assert [resolve(text, {"code": "lace"}) for text in ("{other}", "code", "{code} ")] == [
        "{other}",
        "code",
        "{code} ",
    ]
    with pytest.raises(ValueError, match="the environment has no GIIRL_NONE"):
        resolve("{env:GIIRL_NONE}", {})
