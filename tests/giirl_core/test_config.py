"""Settings are read from files and the command line; a mistake is one line that names the nearest setting."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from giirl_core.config import Config
from giirl_core.config_file import dump_config, keys, load_config
from giirl_core.renamed_settings import RENAMED


def test_without_file_and_overrides_all_settings_have_their_defaults() -> None:
    assert load_config(None) == Config()


def test_the_command_line_overrides_the_file(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text('tasks = ["click-test"]\nseed = 3\n[policy]\ngamma = 0.5\n')
    config = load_config(path, ["seed=4", "policy.entropy=0.2", "run=out/a"])
    assert (config.tasks, config.seed, config.run) == (("click-test",), 4, "out/a")
    assert (config.policy.gamma, config.policy.entropy) == (0.5, 0.2)


@settings(max_examples=30)
@given(st.integers(0, (1 << 16) - 1), st.floats(1e-6, 1e6))
def test_a_dumped_config_loads_as_the_same_config(
    tmp_path_factory: pytest.TempPathFactory, seed: int, rate: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "dumped.json"
    config = load_config(None, [f"seed={seed}", f"policy.learning_rate={rate!r}"])
    path.write_text(dump_config(config))
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("polcy.gamma=0.5", "no setting 'polcy'; the nearest is 'policy'"),
        ("policy.gama=0.5", "no setting 'policy.gama'; the nearest is 'policy.gamma'"),
        ("policy.gamma=1.5", "policy.gamma = 1.5"),
        ("policy.entropy=0", "policy.entropy = 0: .* greater than 0"),
        ("policy.entropy=inf", "policy.entropy = inf: .* finite"),
        ("policy.entropy=nan", "policy.entropy = nan"),
        ("policy.sampled_actions=3", "policy.sampled_actions = 3: .* multiple of 2"),
        ("seed=65536", "seed = 65536"),
        ("seed=one", "seed = 'one'"),
        ("net.width=6", "net.width = 6: .* multiple of 4"),
        ("browser=firefox", "browser = 'firefox': .*'chrome' or 'fake'"),
        ("tasks=click-test", "tasks = 'click-test'"),
        ("tasks=[]", "tasks = "),
        ("policy=3", "policy = 3"),
        ("seed.deep=3", "seed = "),
        ("seed", "'seed' is not an override: wanted key=value"),
        ("=1", "'=1' is not an override"),
    ],
)
def test_an_illegal_override_is_a_one_line_error(override: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_config(None, [override])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("start", ["bc_warmup_updates=9", "frozen_iterations=2", "cloning_updates=1"])
def test_a_start_from_a_clone_that_the_grid_does_not_know_is_an_error(start: str) -> None:
    name, value = start.split("=")
    with pytest.raises(ValueError, match=rf"policy\.{name} is {value} and world 'gridcraft': wanted {name}=0"):
        load_config(None, ["world=gridcraft", f"policy.{start}"])


def test_a_start_from_a_clone_for_a_clone_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"policy\.bc_warmup_updates 9: wanted bc_warmup_updates=0 and policy"):
        load_config(None, ["algorithm=cloning", "policy.bc_warmup_updates=9"])


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_key_is_an_error_that_names_the_new_key(old: str, new: str) -> None:
    assert old not in keys()
    assert new in keys()
    with pytest.raises(ValueError, match=f"the setting '{old}' is now '{new}'") as caught:
        load_config(None, [f"{old}=1"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.toml", b"seed = ", "a.toml is not valid TOML"),
        ("a.json", b"{", "a.json is not valid JSON"),
        ("a.json", b"[1]", "holds list, wanted a table"),
        ("a.toml", b"\xff\xfe", "cannot read the config .*a.toml"),
        ("a.toml", b"sede = 1", "a.toml: there is no setting 'sede'; the nearest is 'seed'"),
        ("missing.toml", None, "cannot read the config .*missing.toml"),
    ],
)
def test_an_unreadable_config_file_is_named_in_the_error(
    name: str, content: bytes | None, message: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        load_config(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_an_override_below_a_value_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("policy = 3\n")
    with pytest.raises(ValueError, match="'policy' is a value, not a section"):
        load_config(path, ["policy.gamma=0.5"])


def test_every_setting_has_one_dotted_name() -> None:
    assert {"seed", "policy", "policy.gamma", "discriminator.wrong_goal", "metrics.port"} <= set(keys())
    assert len(keys()) == len(set(keys()))
