"""Task files: what they declare, and the one line that says what is wrong with one."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from browser_farm.mixed import check_task, expert_of, is_measured
from browser_farm.sites.episode import draw
from browser_farm.sites.origins import origin_of, proxy_bypass, resolver_rules
from browser_farm.sites.task_file import load_task
from giirl_core.config_file import load_config

GOOD = 'address = "http://127.0.0.1:8000/"\ninstructions = "Open {name}."\n[fields]\nname = ["Ada", "Grace"]\n'


def write(folder: Path, text: str, name: str = "task.toml") -> str:
    path = folder / name
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("address = ", "is not valid TOML"),
        ('instructions = "Go."', "the key 'address' is missing"),
        ('address = "http://127.0.0.1/"\n', "the key 'instructions' is missing"),
        (GOOD.replace("address", "adress", 1), "there is no key 'adress'; the nearest is 'address'"),
        (GOOD + "[begin]\nrequst = 1\n", "there is no key 'begin.requst'; the nearest is 'begin.request'"),
        (GOOD.replace("{name}", "{nmae}"), r"instructions\[0\] has {nmae}, which is no field: the fields are name"),
        (GOOD.replace('["Ada", "Grace"]', "[]"), "fields.name has no values"),
        (GOOD.replace('["Ada", "Grace"]', "{from = 3, to = 2}"), "fields.name has no values"),
        (GOOD.replace('["Ada", "Grace"]', '{csv = "x.csv", column = "n"}'), "fields.name: cannot read .*x.csv"),
        (GOOD.replace('["Ada", "Grace"]', "7"), "fields.name is 7: wanted a list"),
        (GOOD.replace("name =", "seed ="), "fields.seed is no name for a field"),
        (GOOD.replace("http://127.0.0.1:8000/", "page.html"), "address is 'page.html': wanted http"),
        (
            GOOD.replace("http://127.0.0.1:8000/", "../outside.html"),
            "wanted an HTML file in the folder of the task file",
        ),
        ('origins = "127.0.0.1:8001"\n' + GOOD, "origins has '127.0.0.1:8001': wanted scheme://host:port"),
        (GOOD + '[begin]\nrequest = "/reset"\n', "begin.request is '/reset': wanted a method and an address"),
        (GOOD + '[begin]\ncommand = ["reset", "{who}"]\n', "begin.command has {who}, which is no field"),
        ("viewport = [10, 10]\n" + GOOD, "viewport.0 = 10"),
        ('expert = "experts.py"\n' + GOOD, "expert is 'experts.py': wanted FILE.py:FUNCTION"),
    ],
)
def test_a_wrong_task_file_is_one_line_with_its_name(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "outside.html").write_text("<p>outside</p>")
    (tmp_path / "tasks").mkdir()
    name = write(tmp_path / "tasks", text)
    with pytest.raises(ValueError, match=message) as error:
        load_task(name)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_a_task_file_that_does_not_exist_is_named() -> None:
    with pytest.raises(ValueError, match=r"cannot read the task file nowhere\.toml: No such file"):
        check_task("nowhere.toml")


def test_the_same_seed_draws_the_same_instruction_and_seeds_draw_every_value(tmp_path: Path) -> None:
    task = load_task(write(tmp_path, GOOD))
    drawn = Counter(draw(task, seed).goal.utterance for seed in range(100))
    assert set(drawn) == {"Open Ada.", "Open Grace."}
    assert min(drawn.values()) > 25
    assert draw(task, 7).goal == draw(task, 7).goal
    assert draw(task, 7).values["episode"] != draw(task, 7).values["episode"]


def test_columns_of_one_csv_file_are_drawn_from_one_row(tmp_path: Path) -> None:
    (tmp_path / "orders.csv").write_text("number,customer\n1,Ada\n2,Grace\n3,Edsger\n")
    fields = (
        '[fields]\norder = {csv = "orders.csv", column = "number"}\nwho = {csv = "orders.csv", column = "customer"}\n'
    )
    task = load_task(write(tmp_path, f'address = "http://127.0.0.1/"\ninstructions = "{{order}} {{who}}"\n{fields}'))
    assert {draw(task, seed).goal.utterance for seed in range(60)} == {"1 Ada", "2 Grace", "3 Edsger"}


def test_instructions_may_be_a_list_of_sentences_and_ranges_have_steps(tmp_path: Path) -> None:
    text = 'address = "http://127.0.0.1/"\ninstructions = ["Pay {n}.", "Stop."]\n'
    task = load_task(write(tmp_path, text + "[fields]\nn = {from = 10, to = 30, step = 10}\n"))
    drawn = {draw(task, seed).goal.utterance for seed in range(100)}
    assert drawn == {"Pay 10.", "Pay 20.", "Pay 30.", "Stop."}


def test_a_task_is_measured_only_if_its_file_says_what_success_is(tmp_path: Path) -> None:
    assert not is_measured(write(tmp_path, GOOD))
    assert is_measured(write(tmp_path, GOOD + '[success]\nselector = "#ok"\n', "other.toml"))
    assert is_measured("click-button")


def test_a_folder_of_task_files_is_expanded_in_a_config(tmp_path: Path) -> None:
    names = [write(tmp_path, GOOD, name) for name in ("a.toml", "b.toml")]
    assert load_config(None, [f'tasks=["click-link", "{tmp_path}/"]']).tasks == ("click-link", *names)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ValueError, match="which has no task file"):
        load_config(None, [f'tasks=["{empty}/"]'])


def test_an_expert_is_a_function_of_the_users_own_file(tmp_path: Path) -> None:
    (tmp_path / "experts.py").write_text("def act(view):\n    return view.wait()\n")
    assert callable(expert_of(write(tmp_path, 'expert = "experts.py:act"\n' + GOOD, "with.toml")))
    with pytest.raises(ValueError, match="has no function other"):
        expert_of(write(tmp_path, 'expert = "experts.py:other"\n' + GOOD, "wrong.toml"))
    with pytest.raises(ValueError, match="names no scripted expert"):
        expert_of(write(tmp_path, GOOD, "without.toml"))


def test_origins_are_compared_without_path_and_default_port() -> None:
    assert origin_of("http://a.test:80/x?y") == "http://a.test"
    assert origin_of("https://a.test:8443/") == "https://a.test:8443"
    assert origin_of("http://[::1]:8000/") == "http://[::1]:8000"
    assert origin_of("about:blank") == origin_of("http://a:b:c/") == ""


def test_only_allowed_origins_pass_the_proxy_and_are_looked_up() -> None:
    rules = proxy_bypass(["http://127.0.0.1:8000", "https://app.test"])
    assert rules.split(";")[0] == "<-loopback>"
    assert "http://127.0.0.1:8000" in rules
    assert "wss://app.test:443" in rules
    assert resolver_rules(["https://app.test"]) == "MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE app.test"
