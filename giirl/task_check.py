"""The check of a task file: its first page in real Chrome, with what an agent sees of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.table import Table

from browser_farm.sites.episode import draw
from browser_farm.sites.farm import SiteFarm
from browser_farm.sites.page import WIDTH
from browser_farm.sites.task_file import SUFFIX, SiteTask, is_site, load_task
from giirl_core.types import EpisodeSpec, Page, Purpose, page_seed

SENTENCES = 5  # instructions that are shown
TAB = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskCheck:
    """What a task file gives: instructions, and the first page of the first of them."""

    task: SiteTask
    instructions: tuple[str, ...]
    page: Page
    png: bytes
    left_out: int  # elements of the page that an agent does not see
    refused: dict[str, int]  # requests by host and port
    failing_scripts: tuple[str, ...]  # what the scripts of [end] and [success] throw on the page

    def notes(self) -> list[str]:
        """What a user should know about the page, a line each."""
        lines = [f"{len(self.page)} elements, {int(self.page.leaf.sum())} of them can be clicked"]
        if self.left_out:
            lines.append(
                f"{self.left_out} more are left out: an agent sees the {self.task.file.max_elements} nearest to what "
                "is in view (max_elements)"
            )
        if self.refused:
            lines.append(f"refused requests: {', '.join(f'{host} {n}' for host, n in sorted(self.refused.items()))}")
        lines += [f"{error}; a condition whose script throws does not hold" for error in self.failing_scripts]
        if not self.task.file.end:
            lines.append("without [end], episodes end at the step limit only")
        if not self.task.measured:
            lines.append("without [success], the task can be trained and is not evaluated")
        return lines

    def summary(self) -> dict[str, Any]:
        """The check as JSON."""
        rows = zip(self.page.tag, self.page.text, self.page.value, strict=True)
        return {
            "task": self.task.name,
            "instructions": list(self.instructions),
            "elements": [{"tag": tag, "text": text, "value": value} for tag, text, value in rows],
            "left_out": self.left_out,
            "refused": self.refused,
            "failing_scripts": list(self.failing_scripts),
            "measured": self.task.measured,
        }


def check_task(name: str, seed: int) -> TaskCheck:
    """Open the first page of a task. ValueError or RuntimeError, one line, that says what is wrong."""
    if not is_site(name):
        raise ValueError(f"{name} is no task file: wanted NAME{SUFFIX}")
    task = load_task(name)
    seeds = [page_seed(Purpose.INSPECT, seed, index) for index in range(SENTENCES)]
    with SiteFarm([name], tabs=1) as farm:
        opened = farm.reset({TAB: EpisodeSpec(task=name, seed=seeds[0])})
        if TAB not in opened:
            raise RuntimeError(farm.unopened[TAB])
        width, height = task.file.viewport
        png = farm.screenshot(TAB, (0.0, 0.0, WIDTH, WIDTH * height / width), scale=width / WIDTH)
        left_out = farm.left_out(TAB)
        refused = dict(farm.refused)
        failing = tuple(farm.failing_scripts(TAB))
    sentences = tuple(dict.fromkeys(draw(task, seed).goal.utterance for seed in seeds))
    return TaskCheck(
        task=task,
        instructions=sentences,
        page=opened[TAB].page,
        png=png,
        left_out=left_out,
        refused=refused,
        failing_scripts=failing,
    )


def elements_table(check: TaskCheck) -> Table:
    """The elements of the page, as an agent sees them."""
    page, table = check.page, Table(title=f"first page of {check.task.name}")
    for name in ("row", "tag", "text", "value", "left", "top", "width", "height"):
        table.add_column(name, justify="left" if name in ("tag", "text", "value") else "right")
    px = check.task.file.viewport[0] / WIDTH
    depth: list[int] = []
    for row in range(len(page)):
        parent = int(page.parent[row])
        depth.append(depth[parent] + 1 if parent >= 0 else 0)
        box = [f"{px * length:.0f}" for length in page.box[row].tolist()]
        table.add_row(str(row), "  " * depth[row] + page.tag[row], page.text[row], page.value[row], *box)
    return table
