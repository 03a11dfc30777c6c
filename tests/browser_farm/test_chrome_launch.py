"""Chrome on machines where it does not start: what it said, what mends it, and no second try that fails alike.

Most of these machines are real: namespaces, limits and files of the kernel. `counted` programs that write an error
themselves simulate what cannot be had here, with the lines that Chrome writes there.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from browser_farm.chrome import launcher
from browser_farm.farm import ChromeFarm
from tests.browser_farm import machines
from tests.browser_farm.machines import NO_NAMESPACES, OPENED, counted, launch, mounted, run, starts

pytestmark = pytest.mark.chrome

REAL = f'exec {launcher.find("GIIRL_CHROME", launcher.CHROMES, "Chrome")} "$@"'


def test_without_user_namespaces_the_error_quotes_chrome_names_the_setting_and_comes_after_one_start(
    tmp_path: Path,
) -> None:
    said = launch(NO_NAMESPACES, GIIRL_CHROME=str(counted(tmp_path, REAL)))
    assert "No usable sandbox!" in said
    assert "actors.chrome_sandbox=off or GIIRL_CHROME_SANDBOX=off" in said
    assert "\n" not in said
    assert starts(tmp_path) == 1


def test_without_user_namespaces_pages_open_with_the_environment_variable() -> None:
    assert launch(NO_NAMESPACES, GIIRL_CHROME_SANDBOX="off") == OPENED


@pytest.mark.slow
@pytest.mark.parametrize("extra", ["chrome_sandbox='off'", "chrome_sandbox='on'"])
def test_without_user_namespaces_the_environments_need_their_argument(extra: str) -> None:
    script = (
        "import gymnasium, browser_farm",
        f"env = gymnasium.make('giirl/MiniWoB-v0', task='click-test', {extra})",
        "print(env.reset(seed=1)[0]['utterance'])",
        "env.close()",
        f"env = gymnasium.make_vec('giirl/MiniWoB-v0', num_envs=1, task='click-test', {extra})",
        "print(env.reset(seed=1)[0]['utterance'][0])",
        "env.close()",
    )
    done = run(NO_NAMESPACES, *machines.script(*script))
    if "off" in extra:
        assert done.stdout.splitlines() == [OPENED, OPENED]
    else:
        assert "No usable sandbox!" in done.stderr


@pytest.mark.slow
def test_without_user_namespaces_demonstrations_are_made_with_the_setting(tmp_path: Path) -> None:
    words = ("-m", "giirl", "demos", "make", "--task", "click-test", "--per-task", "2", "--out", str(tmp_path / "d"))
    assert "No usable sandbox!" in run(NO_NAMESPACES, *words).stderr
    done = run(NO_NAMESPACES, *words, GIIRL_CHROME_SANDBOX="off")
    assert done.returncode == 0, done.stderr


def test_a_window_without_a_screen_is_an_error_that_says_so() -> None:
    said = launch("env -u DISPLAY -u WAYLAND_DISPLAY", "window")
    assert "there is no screen: DISPLAY is not set, wanted a desktop or xvfb-run" in said


def test_too_few_open_files_are_an_error_that_says_so() -> None:
    said = launch("ulimit -n 64;")
    assert "Too many open files" in said
    assert "ulimit -n 4096" in said


@pytest.mark.parametrize(("variable", "what"), [("GIIRL_CHROME", "Chrome"), ("GIIRL_CHROMEDRIVER", "chromedriver")])
def test_another_program_in_the_place_of_chrome_is_named(variable: str, what: str) -> None:
    said = launch(**{variable: "/bin/ls"})
    assert said.startswith("/bin/ls did not start: ")
    assert f"this program is no {what}" in said
    assert f"set {variable}" in said


def test_a_policy_against_remote_debugging_is_named_without_waiting_for_the_timeout(tmp_path: Path) -> None:
    program = counted(tmp_path, REAL)
    (tmp_path / "etc/policies/managed").mkdir(parents=True)
    (tmp_path / "etc/policies/managed/a.json").write_text(json.dumps({"RemoteDebuggingAllowed": False}))
    said = launch(mounted(tmp_path / "etc", "/etc/chromium"), GIIRL_CHROME=str(program))
    assert "remote debugging is disallowed" in said
    assert "RemoteDebuggingAllowed" in said
    assert "did not start within" not in said
    assert starts(tmp_path) == 1


SIMULATED = [
    ("chrome: error while loading shared libraries: libnss3.so: cannot open shared object file", "apt-get install", 1),
    ("[1:1:1129/175124.280642:FATAL:base/x.cc:1] Failed to write: No space left on device (28)", "TMPDIR", 1),
    ("[1:1:1129/175124.280642:ERROR:base/y.cc:2] fork: Resource temporarily unavailable (11)", "ulimit -u", 3),
    ("[1:1:1129/175124.280642:ERROR:base/z.cc:3] The unexpected has happened", "unexpected has happened", 3),
]


@pytest.mark.parametrize(("line", "mend", "attempts"), SIMULATED)
def test_what_chrome_wrote_last_is_quoted_and_what_fails_at_once_is_not_repeated(
    line: str, mend: str, attempts: int, tmp_path: Path
) -> None:
    said = launch(GIIRL_CHROME=str(counted(tmp_path, f"echo '{line}' >&2; exit 1")))
    assert line.rpartition("] ")[2] in said
    assert mend in said
    assert starts(tmp_path) == attempts


def test_a_driver_for_another_chrome_is_named_with_the_command_that_mends_it(tmp_path: Path) -> None:
    """Simulated: a chromedriver that answers as one of an older version does."""
    message = "session not created: This version of ChromeDriver only supports Chrome version 99"
    driver = tmp_path / "driver.py"
    driver.write_text(OLD_DRIVER.format(message=message))
    program = tmp_path / "chromedriver"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {driver} "$@"\n')
    program.chmod(0o755)
    said = launch(GIIRL_CHROMEDRIVER=str(program))
    assert "only supports Chrome version 99" in said
    assert "--only-upgrade chromium chromium-driver" in said
    assert "attempts" not in said


OLD_DRIVER = """
import http.server, json
class Handler(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        body = json.dumps({{"value": {{"error": "session not created", "message": "{message}", "stacktrace": ""}}}})
        self.send_response(500)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body.encode())
    def log_message(self, *words):
        pass
server = http.server.HTTPServer(("127.0.0.1", 0), Handler)
print(f"Starting ChromeDriver 99\\nChromeDriver was started successfully on port {{server.server_port}}.", flush=True)
server.serve_forever()
"""


def test_chrome_is_found_where_localhost_is_the_ipv6_address_alone(tmp_path: Path) -> None:
    (tmp_path / "hosts").write_text("::1 localhost\n")
    assert launch(mounted(tmp_path / "hosts", "/etc/hosts")) == OPENED


def test_a_machine_without_the_name_localhost_is_told_which_line_it_lacks(tmp_path: Path) -> None:
    (tmp_path / "hosts").write_text("\n")
    said = launch(mounted(tmp_path / "hosts", "/etc/hosts"))
    assert "127.0.0.1 localhost" in said
    assert "attempts" not in said


def test_programs_are_found_by_a_relative_path_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted(tmp_path, REAL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIIRL_CHROME", "./chrome")
    with ChromeFarm(tabs=1) as farm:
        assert farm.tabs == 1
    assert starts(tmp_path) == 1


@pytest.mark.parametrize(
    ("setting", "variable", "root", "used"),
    [
        ("auto", "", True, False),
        ("auto", "", False, True),
        ("auto", "on", True, True),
        ("auto", "off", False, False),
        ("on", "off", True, True),
        ("off", "on", False, False),
    ],
)
def test_the_setting_comes_before_the_variable_and_root_has_no_sandbox_unless_told(
    setting: str, variable: str, root: bool, used: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIIRL_CHROME_SANDBOX", variable)
    monkeypatch.setattr("os.geteuid", lambda: 0 if root else 1000)
    assert launcher.uses_sandbox(setting) is used  # type: ignore[arg-type]


def test_a_wrong_word_for_the_sandbox_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="chrome_sandbox is 'yes': wanted auto, on or off"):
        launcher.uses_sandbox("yes")  # type: ignore[arg-type]
    monkeypatch.setenv("GIIRL_CHROME_SANDBOX", "no")
    with pytest.raises(ValueError, match="GIIRL_CHROME_SANDBOX is 'no': wanted auto, on or off"):
        launcher.uses_sandbox("auto")
