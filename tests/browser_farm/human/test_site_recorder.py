"""Recording a person on pages of their own, in real Chrome with trusted input, and playing it again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from browser_farm.chrome.devtools import BrowserGone
from browser_farm.human.site_recorder import SiteRecorder
from browser_farm.sites.farm import SiteFarm
from giirl_core.types import Command, Episode, EpisodeSpec
from giirl_core.wire.messages import read_episodes, write_episodes
from tests.browser_farm.human.person import Person, record

pytestmark = pytest.mark.chrome

PASSWORD = "correct horse 7"
ORDER = """<!DOCTYPE html><meta http-equiv="Content-Security-Policy" content="default-src 'self' 'unsafe-inline'">
<title>Order</title><script>if (top !== self) top.location = self.location;</script><h1>New order</h1>
<form action=confirm.html><label for=name>Customer</label> <input id=name name=name>
<label>Password <input type=password name=secret></label>
<select name=size aria-label=Size><option>small<option>large</select>
<label><input type=checkbox name=gift> Gift</label> <button type=button onclick="ask()">Check</button>
<p id=out>unchecked</p><button>Next</button></form>
<script>function ask() { out.textContent = confirm('Is it right?') + ' ' + prompt('Your name?', 'nobody'); }</script>"""
CONFIRM = """<!DOCTYPE html><title>Confirm</title><div style="height: 2000px">Read all of this</div>
<button onclick="document.body.innerHTML = '<p class=done>Thanks</p>'">Confirm</button>"""
PARTS = """<!DOCTYPE html><my-card></my-card><iframe src=inside.html></iframe><script>
customElements.define('my-card', class extends HTMLElement { connectedCallback() {
  this.attachShadow({mode: 'open'}).innerHTML = '<button><b>Shade</b></button>'; } });</script>"""
INSIDE = "<!DOCTYPE html><button>Inside</button>"
NAMES = ["Ada", "Grace", "Edsger", "Barbara"]
HOSTILE = "<img src=x onerror=document.title='bad'></div><script>document.title='bad'</script>"
TASKS = {
    "order": f"""address = "order.html"
instructions = 'Order a large one for "{{name}}".'
[fields]
name = {NAMES}
[end]
selector = ".done"
[success]
script = '''((p) => p.get('name') === {{name}} && p.get('size') === 'large' && p.get('gift') === 'on'
  && p.get('secret') === '{PASSWORD}')(new URLSearchParams(location.search))'''
""",
    "open": """address = "order.html"\ninstructions = 'Type "{name}".'\n[fields]\nname = ["Grace"]\n""",
    "parts": """address = "parts.html"\ninstructions = "Press everything."\n""",
    "hostile": f"""address = "inside.html"\ninstructions = "Press {{what}}"\n[fields]\nwhat = ["{HOSTILE}"]\n""",
    "nowhere": """address = "http://127.0.0.1:4319/"\ninstructions = "Do it."\n[wait]\ndeadline_s = 2\n""",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    for name, text in {"order": ORDER, "confirm": CONFIRM, "parts": PARTS, "inside": INSIDE}.items():
        (folder / f"{name}.html").write_text(text)
    for name, text in TASKS.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


def open_recorder(folder: Path) -> SiteRecorder:
    return SiteRecorder([str(folder / f"{name}.toml") for name in TASKS], headless=True, environment={})


@pytest.fixture(scope="module")
def recorder(folder: Path) -> Iterator[SiteRecorder]:
    with closing(open_recorder(folder)) as recorder:
        yield recorder


def spec(folder: Path, name: str, seed: int = 1) -> EpisodeSpec:
    return EpisodeSpec(task=str(folder / f"{name}.toml"), seed=seed)


def actions_of(episode: Episode | None) -> list[tuple[str, str, str]]:
    """(verb, text or tag of the element, typed text) of every action."""
    assert episode is not None
    trajectory, lines = episode.trajectory, []
    for page, action in zip(trajectory.pages, trajectory.actions, strict=True):
        name = page.text[action.element] or page.tag[action.element]
        lines.append((action.verb.name, name, action.text(trajectory.goal)))
    return lines


def order(person: Person, name: str) -> None:
    """Order as the instruction says, with mouse, keys, a list, two dialogs, and a second page."""
    person.click("label", "Customer")
    person.type(name)
    person.press("Tab")
    person.type(PASSWORD)
    person.press("Tab")
    person.press("ArrowDown")
    person.click("input[type=checkbox]")
    person.click("button", "Check")
    person.answer(accept=True)
    person.answer(accept=True, text="me")
    person.wait(lambda: person.ask("out.textContent") == "true me", "the answers")
    person.press("Tab")
    person.press("Enter")
    person.wait(lambda: person.ask("document.title") == "Confirm", "the second page")
    person.look_around("Confirm")
    person.ask("document.querySelector('button').scrollIntoView(); 'ok'")
    person.click("button", "Confirm")


def name_in(person: Person) -> str:
    """The quoted name in the instruction, as the bar shows it."""
    person.read('"')
    return person.bar().split('"')[1]


def play_again(folder: Path, episode: Episode, monkeypatch: pytest.MonkeyPatch) -> float:
    """The page's verdict on the actions of an episode in a farm."""
    monkeypatch.setenv("GIIRL_PASSWORD", PASSWORD)
    trajectory, task = episode.trajectory, episode.trajectory.task
    with SiteFarm([task], tabs=1) as farm:
        seen = farm.reset({0: EpisodeSpec(task=task, seed=trajectory.seed)})[0]
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True):
            assert (seen.page.tag, seen.page.text) == (page.tag, page.text)
            assert [value.replace(PASSWORD, "{env:GIIRL_PASSWORD}") for value in seen.page.value] == list(page.value)
            assert (seen.page.tampered == page.tampered).all()
            assert seen.page.box.tolist() == page.box.tolist()
            result = farm.step({0: Command.of(action, seen)})[0]
            if result.observation is None:
                return result.raw_reward
            seen = result.observation
    raise AssertionError("the episode did not end")


def test_what_a_person_does_on_two_pages_and_in_dialogs_is_recorded_and_succeeds_when_it_is_played_again(
    recorder: SiteRecorder, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def act(person: Person) -> None:
        person.read("0 of 1 recorded")
        order(person, name_in(person))
        person.read("it succeeded")
        person.choose("Keep")

    episode = record(recorder, spec(folder, "order"), act)
    name = episode.trajectory.goal.utterance.split('"')[1] if episode else ""
    assert actions_of(episode) == [
        ("TYPE", "Customer", name),
        ("TYPE", "Password", "{env:GIIRL_PASSWORD}"),
        ("CLICK", "large", ""),
        ("CLICK", "Gift", ""),
        ("CLICK", "Check", ""),
        ("CLICK", "OK", ""),
        ("TYPE", "Your name?", "me"),
        ("CLICK", "OK", ""),
        ("CLICK", "Next", ""),
        ("CLICK", "Confirm", ""),
    ]
    assert episode is not None
    assert episode.outcome.success
    file = tmp_path / "mine"
    write_episodes(file, [episode])
    assert PASSWORD.encode() not in file.read_bytes()
    (again,) = read_episodes(file)
    assert play_again(folder, again, monkeypatch) == 1.0


def test_an_episode_is_discarded_done_again_marked_as_failed_or_said_to_be_done(
    recorder: SiteRecorder, folder: Path
) -> None:
    def type_and(choice: str) -> list[tuple[str, str, str]] | None:
        def act(person: Person) -> None:
            person.click("#name")
            person.type(name_in(person))
            person.read("actions so far: 1")
            person.choose(choice)

        recorded = record(recorder, spec(folder, "open"), act)
        outcomes.append(recorded.outcome.raw_reward if recorded else None)
        return actions_of(recorded) if recorded else None

    outcomes: list[float | None] = []
    name = [("TYPE", "Customer", "Grace")]
    assert [type_and(choice) for choice in ("Done", "It failed", "Discard")] == [name, name, None]
    assert outcomes == [1.0, -1.0, None]

    def act_twice(person: Person) -> None:
        person.click("#name")
        person.type("wrong")
        person.choose("Redo")
        person.look_at_page()
        person.read("actions so far: 0")
        person.click("#name")
        person.type(name_in(person))
        person.choose("Done")

    assert actions_of(record(recorder, spec(folder, "open"), act_twice)) == name


def test_nothing_done_is_no_episode(recorder: SiteRecorder, folder: Path) -> None:
    assert record(recorder, spec(folder, "open"), lambda person: person.choose("Done")) is None


def test_an_episode_that_the_page_has_ended_can_be_done_again_or_marked_as_failed(
    recorder: SiteRecorder, folder: Path
) -> None:
    def act(person: Person) -> None:
        person.ask("location = 'confirm.html'; 'ok'")
        person.wait(lambda: person.ask("document.title") == "Confirm", "the second page")
        person.ask("document.querySelector('button').scrollIntoView(); 'ok'")
        person.click("button")
        person.read("it failed")
        person.choose("Redo")
        person.look_at_page()
        order(person, name_in(person))
        person.read("it succeeded")
        person.choose("It failed")

    episode = record(recorder, spec(folder, "order", seed=2), act)
    assert len(actions_of(episode)) == 10
    assert episode is not None
    assert episode.outcome.raw_reward == -1.0


def test_clicks_in_shadow_roots_and_frames_are_clicks_on_what_an_agent_sees_there(
    recorder: SiteRecorder, folder: Path
) -> None:
    def act(person: Person) -> None:
        person.wait(lambda: person.ask("String(frames[0].document.readyState)") == "complete", "the frame")
        person.click("my-card")
        person.read("actions so far: 1")
        place = person.ask("""JSON.stringify((() => { const frame = document.querySelector('iframe');
          const box = frame.getBoundingClientRect(), inner = frame.contentDocument.querySelector('button');
          const own = inner.getBoundingClientRect();
          return [box.left + frame.clientLeft + own.left + 9, box.top + frame.clientTop + own.top + 9]; })())""")
        person.click_at(*json.loads(place))
        person.read("actions so far: 2")
        person.choose("Done")

    episode = record(recorder, spec(folder, "parts"), act)
    assert actions_of(episode) == [("CLICK", "Shade", ""), ("CLICK", "Inside", "")]


def test_hostile_text_in_the_bar_is_text(recorder: SiteRecorder, folder: Path) -> None:
    def act(person: Person) -> None:
        person.read(HOSTILE)
        person.read("<b>note</b>")
        assert person.ask_bar("String(document.querySelectorAll('img, script, b').length)") == "0"
        assert person.ask_bar("document.title") == "Recording"
        person.choose("Discard")

    assert record(recorder, spec(folder, "hostile"), act, note="<b>note</b>") is None


def test_nothing_of_the_bar_or_of_the_recording_is_in_the_page(recorder: SiteRecorder, folder: Path) -> None:
    def act(person: Person) -> None:
        known = "[typeof giirlStep, typeof giirlChoose, typeof giirlRecorder, typeof person].join()"
        assert person.ask(known) == "undefined,undefined,undefined,undefined"
        assert "recorded" not in person.ask("document.documentElement.outerHTML")
        person.choose("Discard")

    assert record(recorder, spec(folder, "open"), act) is None


def test_an_address_that_does_not_answer_is_one_line(recorder: SiteRecorder, folder: Path) -> None:
    with pytest.raises(RuntimeError, match=r"nowhere.toml does not open: unreachable .*CONNECTION_REFUSED") as error:
        recorder.record(spec(folder, "nowhere"), lambda goal: None)
    assert "\n" not in str(error.value)


def test_a_closed_window_ends_the_recording_and_keeps_an_episode_that_is_complete(folder: Path) -> None:
    def act(person: Person) -> None:
        order(person, name_in(person))
        person.read("it succeeded")
        person.close_window(of_bar=True)

    with closing(open_recorder(folder)) as recorder:
        episode = record(recorder, spec(folder, "order"), act)
        assert episode is not None
        assert episode.outcome.success
        with pytest.raises(BrowserGone, match="the window was closed"):
            recorder.record(spec(folder, "order"), lambda goal: None)
    with closing(open_recorder(folder)) as recorder, pytest.raises(BrowserGone, match="the window was closed"):
        record(recorder, spec(folder, "order"), Person.close_window)
