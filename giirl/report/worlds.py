"""What differs between the reports of the two worlds: text, tables, charts and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from giirl.report.element_rewards import EpisodeView
from giirl.report.grid import GridReport
from giirl.report.heatmap import Maps
from giirl.report.numbers import Group, Points, Result, TableView
from giirl.report.web import WebReport
from giirl.run.folder import RunFolder
from giirl_core.algorithms import WorldName
from giirl_core.config import Config
from giirl_core.progress import Display


class WorldReport(Protocol):
    """The sections of a report, each from what the folder of the run holds."""

    def subject(self, config: Config) -> str:
        """What the run learned on, for the first sentence."""

    def facts(self, config: Config) -> dict[str, str]:
        """More facts for the head of the report."""

    def result_lines(self, result: Result) -> list[str]:
        """Text above the tables of the result."""

    def result_tables(self, result: Result) -> list[TableView]:
        """The result as tables."""

    def success_group(
        self, config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]
    ) -> Group:
        """Charts of success or return against environment steps."""

    def strips(
        self, folder: RunFolder, config: Config, pages: int, display: Display
    ) -> tuple[dict[str, list[EpisodeView]], str]:
        """`pages` episodes of each task, and the text above them."""

    def maps(self, folder: RunFolder, config: Config) -> Maps | None:
        """The learned reward as maps."""


REPORTS: dict[WorldName, WorldReport] = {"miniwob": WebReport(), "gridcraft": GridReport()}


def report_of(config: Config) -> WorldReport:
    """The sections for the world that a config names."""
    return REPORTS[config.world]
