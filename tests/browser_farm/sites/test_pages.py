"""Real pages in real Chrome: what an agent sees of them, and what its actions do."""

from __future__ import annotations

import pytest

from giirl_core.types import Command, Verb
from tests.browser_farm.sites.player import Player, after, ref_of, row_of

pytestmark = pytest.mark.chrome


def test_a_form_is_filled_in_and_sent_and_the_next_page_belongs_to_the_episode(player: Player) -> None:
    seen = player.open("form")
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Customer", "input_text"), "Ada Lovelace"))
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Amount", "input_number"), "42"))
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Day", "input_date"), "02/08/2024"))
    seen = after(player.act(Verb.CLICK, ref_of(seen, "green")))
    seen = after(player.act(Verb.CLICK, ref_of(seen, "Gift", "input_checkbox")))
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Remark", "textarea"), "Fragile"))
    assert seen.page.value[row_of(seen, "Customer", "input_text")] == "Ada Lovelace"
    assert seen.page.value[row_of(seen, "Gift", "input_checkbox")] == "checked"
    assert seen.page.tampered[row_of(seen, "Customer", "input_text")]
    assert "green" in seen.page.value
    seen = after(player.click(seen, "Save"))
    row_of(seen, "Saved", "h1")
    sent = player.site.posted[-1]
    wanted = {"name": "Ada Lovelace", "amount": "42", "day": "2024-02-08", "colour": "green", "gift": "yes"}
    assert sent == {**wanted, "note": "Fragile"}


def test_typing_replaces_what_a_field_holds(player: Player) -> None:
    seen = player.open("form")
    for text in ("first", "second"):
        seen = after(player.act(Verb.TYPE, ref_of(seen, "Customer", "input_text"), text))
    assert seen.page.value[row_of(seen, "Customer", "input_text")] == "second"


def test_refs_of_an_earlier_page_mean_nothing_on_the_next_one(player: Player) -> None:
    seen = player.open("other")
    first = {int(ref) for ref in seen.page.ref}
    seen = after(player.click(seen, "Back"))
    assert first.isdisjoint(int(ref) for ref in seen.page.ref)
    before = seen.page.text
    assert after(player.act(Verb.CLICK, min(first))).page.text == before


@pytest.mark.parametrize(("task", "text"), [("form", "Other"), ("popup", "Open")])
def test_a_new_window_stays_in_the_tab(player: Player, task: str, text: str) -> None:
    row_of(after(player.click(player.open(task), text)), "Other page")


def test_a_confirmation_is_what_the_agent_sees_until_it_is_answered(player: Player) -> None:
    for answer, outcome in (("OK", "deleted"), ("Cancel", "kept")):
        seen = after(player.click(player.open("dialogs"), "Delete"))
        assert seen.page.tag == ("dialog", "t", "button", "button")
        assert seen.page.text == ("", "Delete it?", "OK", "Cancel")
        row_of(after(player.click(seen, answer)), outcome)


def test_a_prompt_has_a_field_and_an_alert_only_a_button(player: Player) -> None:
    seen = after(player.click(player.open("dialogs"), "Ask"))
    assert seen.page.value[row_of(seen, "Your name?", "input_text")] == "Ada"
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Your name?", "input_text"), "Grace"))
    seen = after(player.click(seen, "OK"))
    row_of(seen, "Name Grace")
    seen = after(player.click(seen, "Alert"))
    assert "Cancel" not in seen.page.text
    row_of(after(player.click(seen, "OK")), "alerted")


def test_a_page_that_asks_before_it_is_left_is_left(player: Player) -> None:
    row_of(after(player.click(player.open("unload"), "Go")), "Other page")


@pytest.mark.parametrize(("task", "text"), [("frames", "Inside"), ("shadow", "Shade"), ("covered", "Deep below")])
def test_elements_in_frames_in_shadow_roots_and_out_of_view_are_clicked(player: Player, task: str, text: str) -> None:
    row_of(after(player.click(player.open(task), text)), "Pressed")


def test_a_field_in_a_shadow_root_is_typed_into(player: Player) -> None:
    seen = player.open("shadow")
    seen = after(player.act(Verb.TYPE, ref_of(seen, "Deep"), "word"))
    row = row_of(seen, "Deep")
    assert (seen.page.value[row], bool(seen.page.focused[row])) == ("word", True)


def test_scrolling_moves_the_page(player: Player) -> None:
    seen = player.open("covered")
    top = float(seen.page.box[row_of(seen, "Deep below"), 1])
    seen = after(player.farm.step({0: Command(verb=Verb.SCROLL, at=(80.0, 60.0), by=(0.0, 100.0))})[0])
    assert float(seen.page.box[row_of(seen, "Deep below"), 1]) < top


def test_a_step_waits_for_the_network_and_for_what_changes_soon(player: Player) -> None:
    seen = player.open("slow")
    row_of(after(player.click(seen, "Load")), "loaded")
    row_of(after(player.click(player.open("slow"), "Later")), "late")


def test_what_may_change_at_any_time_is_not_waited_for(player: Player) -> None:
    assert player.open("silent").page.tag == ("p",)
    assert player.open("polls").page.text == ("Polls",)


def test_the_page_has_the_attributes_that_describe_elements(player: Player) -> None:
    page = player.open("described").page
    found = dict(zip(page.tag, page.attributes, strict=True))
    assert found == {"input_text": "who Your name", "img": "A cat", "button": "close Close it", "p": "", "a": "way"}


def test_hidden_elements_have_no_rows_and_a_modal_dialog_hides_the_rest(player: Player) -> None:
    assert player.open("hidden").page.text == ("Seen",)
    assert player.open("modal").page.text == ("", "In front", "Yes")


def test_a_large_page_is_cut_to_what_is_nearest_and_the_rest_is_counted(player: Player) -> None:
    seen = player.open("few")
    assert len(seen.page) <= 40
    assert seen.page.text[:2] == ("Many", "Link 0")
    assert player.farm.left_out(0) > 400
    player.act(Verb.WAIT, 0)
    assert player.counts["elements_left_out"] > 400


def test_file_inputs_are_refused_with_a_reason(player: Player) -> None:
    seen = player.open("form")
    result = player.act(Verb.CLICK, ref_of(seen, "Invoice", "input_file"))
    assert result.reason == "file inputs are refused"
    assert player.counts["file_inputs_refused"] == 1
    row_of(after(result), "Save")


def test_an_episode_ends_by_its_condition_and_success_is_measured_then(player: Player) -> None:
    for task, reward in (("ends", 1.0), ("loses", -1.0)):
        seen = player.open(task)
        result = player.act(Verb.TYPE, ref_of(seen, "Customer", "input_text"), "Ada")
        assert (result.done, result.raw_reward) == (False, 0.0)
        checks = sum("/check/" in request for request in player.site.requests)
        result = player.click(after(result), "Save")
        assert (result.done, result.raw_reward, result.observation) == (True, reward, None)
        assert sum("/check/" in request for request in player.site.requests) == checks + 1  # not before the end


def test_at_the_step_limit_a_failure_is_zero_and_the_next_episode_follows(player: Player) -> None:
    player.open("loses")
    command = Command(verb=Verb.WAIT, last=True, following=player.spec("other", 5))
    result = player.farm.step({0: command})[0]
    assert (result.done, result.raw_reward) == (False, 0.0)
    assert after(result).episode.seed == 5
    row_of(after(result), "Other page")


def test_an_episode_begins_with_a_request_and_a_script(player: Player) -> None:
    seen = player.open("scripted", seed=77)
    row_of(seen, "Order 77", "h1")
    assert "POST /reset?seed=77" in player.site.requests
    assert "GET /form?77" in player.site.requests


def test_html_files_beside_the_task_file_are_played_and_nothing_else_is_served(player: Player) -> None:
    seen = after(player.click(player.open("file"), "Next"))
    row_of(seen, "Next", "h1")
    assert not any("root:" in text for text in seen.page.text)


def test_two_tabs_step_at_the_same_time(player: Player) -> None:
    seen = player.farm.reset({0: player.spec("form"), 1: player.spec("dialogs")})
    results = player.farm.step(
        {
            0: Command(verb=Verb.TYPE, ref=ref_of(seen[0], "Customer", "input_text"), text="Ada"),
            1: Command(verb=Verb.CLICK, ref=ref_of(seen[1], "Delete")),
        }
    )
    assert "Ada" in after(results[0]).page.value
    row_of(after(results[1]), "Delete it?")


def test_a_screenshot_shows_the_page(player: Player) -> None:
    player.open("form")
    assert player.farm.screenshot(0, (0.0, 0.0, 160.0, 120.0)).startswith(b"\x89PNG")
