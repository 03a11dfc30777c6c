"""Tables that describe the same things in several modules agree with each other."""

from __future__ import annotations

from typing import get_args

from benchmarks.transport import BENCHES
from giirl.cli.bench import TRANSPORT, bench
from giirl.cli.reproduce import GRID_COMMANDS, reproduce
from giirl.report.worlds import REPORTS
from giirl.run.worlds import WORLDS
from giirl.studies.grid import STUDIES
from giirl_core.algorithms import WorldName


def test_every_transport_benchmark_has_a_command() -> None:
    assert set(TRANSPORT) == set(BENCHES)
    assert {"farm", "learner", "scaling", "training", *TRANSPORT} == set(bench.commands)


def test_every_study_of_the_grid_has_a_command() -> None:
    assert set(GRID_COMMANDS) == set(STUDIES)
    assert set(GRID_COMMANDS) <= set(reproduce.commands)


WITHOUT_FIGURE = {"gridcraft-ablations", "gridcraft-maxent"}


def test_only_studies_that_draw_a_figure_have_a_folder_for_it() -> None:
    options = {name: {parameter.name for parameter in reproduce.commands[name].params} for name in GRID_COMMANDS}
    assert {name for name, names in options.items() if "out" in names} == set(GRID_COMMANDS) - WITHOUT_FIGURE


def test_every_world_has_an_object_and_a_report() -> None:
    assert set(WORLDS) == set(REPORTS) == set(get_args(WorldName))
