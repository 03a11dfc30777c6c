"""Plays task files for the pages of the test server, in one farm that is opened when it is first used."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from browser_farm.sites.farm import SiteFarm
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult, Verb
from tests.browser_farm.sites.web_site import PAGES, WebSite

TABS = 2
TASKS = {  # besides one for each page
    "ends": 'address = "{site}/form"\n[end]\nselector = "h1.saved"\n[success]\nrequest = "POST /check/ok"\n',
    "loses": 'address = "{site}/form"\n[end]\naddress = "*/saved"\n[success]\nrequest = "POST /check/no"\n',
    "private": 'address = "{site}/private"\n[login]\ncookies = {{user = "Ada"}}\nexpired = {{address = "*/login"}}\n',
    "expired": 'address = "{site}/private"\n[login]\nexpired = {{address = "*/login"}}\n',
    "stored": 'address = "{site}/local"\n[login]\nfile = "login.json"\n',
    "missing": 'address = "{site}/other"\n[begin]\nselector = "#never"\n[wait]\ndeadline_s = 0.5\n',
    "silent": 'address = "{site}/restless"\n[wait]\nignore_elements = "#clock"\n',
    "polls": 'address = "{site}/poll"\n[wait]\nignore_addresses = "*/never"\n',
    "nowhere": 'address = "http://127.0.0.1:4319/"\n[wait]\ndeadline_s = 2\n',
    "away": 'address = "{site}/away"\n',
    "none": 'address = "{site}/no-such-page"\n',
    "scripted": 'address = "{site}/form?{{seed}}"\n[begin]\nrequest = "POST /reset?seed={{seed}}"\n'
    "script = \"document.querySelector('h1').textContent = 'Order ' + {{seed}}\"\n",
    "throws": 'address = "{site}/form"\n[end]\nscript = "document.querySelector(\'#total\').textContent === 1"\n'
    "[success]\nscript = \"document.querySelector('#total').textContent === 1\"\n",
    "file": 'address = "pages/hello.html?name={{name}}"\n[fields]\nname = ["Ada"]\n',
    "few": 'address = "{site}/many"\nmax_elements = 40\n',
}


class Player:
    """A farm and its task files. `causes` and `counts` hold what the farm has reported."""

    def __init__(self, site: WebSite, folder: Path) -> None:
        self.site, self.folder = site, folder
        self.causes: list[str] = []
        self.counts: Counter[str] = Counter()
        (folder / "pages").mkdir()
        (folder / "pages" / "hello.html").write_text("<h1>Hello</h1><a href=next.html>Next</a>")
        (folder / "pages" / "next.html").write_text("<h1>Next</h1><iframe src='/../../etc/passwd'></iframe>")
        items = [{"name": "token", "value": "T1"}]
        login = {"cookies": [], "origins": [{"origin": site.origin, "localStorage": items}]}
        (folder / "login.json").write_text(json.dumps(login))
        texts = {name: text.format(site=site.origin) for name, text in TASKS.items()}
        for page in PAGES:
            quiet = "quiet_ms = 1500\n" if page == "/restless" else ""  # its timers are late on a busy machine
            texts[page.strip("/")] = f'address = "{site.origin}{page}"\n[wait]\ndeadline_s = 2\n{quiet}'
        for name, text in texts.items():
            self.path(name).write_text('instructions = "Do it."\n' + text)
        self.farm = SiteFarm(
            [str(self.path(name)) for name in texts],
            tabs=TABS,
            call_timeout_s=4.0,
            on_restart=self.causes.append,
            on_count=lambda what, count: self.counts.update({what: count}),
        )

    def path(self, name: str) -> Path:
        """The task file."""
        return self.folder / f"{name}.toml"

    def spec(self, name: str, seed: int = 1) -> EpisodeSpec:
        return EpisodeSpec(task=str(self.path(name)), seed=seed)

    def open(self, name: str, *, tab: int = 0, seed: int = 1) -> Observation:
        """Open a page; RuntimeError, with the farm's reason, when it does not open."""
        opened = self.farm.reset({tab: self.spec(name, seed)})
        if tab not in opened:
            raise RuntimeError(self.farm.unopened[tab])
        return opened[tab]

    def act(self, verb: Verb, ref: int, text: str = "", *, tab: int = 0, last: bool = False) -> StepResult:
        return self.farm.step({tab: Command(verb=verb, ref=ref, text=text, last=last)})[tab]

    def click(self, seen: Observation, text: str, *, tab: int = 0, last: bool = False) -> StepResult:
        """Click the first leaf with this text."""
        return self.act(Verb.CLICK, ref_of(seen, text), tab=tab, last=last)

    def close(self) -> None:
        self.farm.close()


def row_of(seen: Observation, text: str, tag: str = "") -> int:
    """The first row with this text; the error shows what there is."""
    page = seen.page
    for row in range(len(page)):
        if page.text[row] == text and tag in ("", page.tag[row]):
            return row
    raise AssertionError(f"no {tag} {text!r} among {list(zip(page.tag, page.text, strict=True))}")


def ref_of(seen: Observation, text: str, tag: str = "") -> int:
    """The ref of the first row with this text."""
    return int(seen.page.ref[row_of(seen, text, tag)])


def after(result: StepResult) -> Observation:
    """The next observation of an episode that goes on."""
    assert result.observation is not None, result
    return result.observation
