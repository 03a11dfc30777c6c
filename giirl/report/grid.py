"""The report sections of a run in LanguageGridCraft."""

from __future__ import annotations

from collections.abc import Mapping

from giirl.report.charts import Line, draw_chart
from giirl.report.element_rewards import EpisodeView
from giirl.report.heatmap import Maps, draw_heat
from giirl.report.numbers import Group, Points, Result, TableView
from giirl.run.folder import RunFolder
from giirl.run.grid import layouts_of, open_run, reward_panels
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.progress import Display


class GridReport:
    """Returns by instruction, their training curves, and heat maps of the learned reward."""

    def subject(self, config: Config) -> str:
        return "LanguageGridCraft"

    def facts(self, config: Config) -> dict[str, str]:
        return {}

    def result_lines(self, result: Result) -> list[str]:
        """Metrics of the learned reward, and the violation rates of its re-optimised policy and of the expert."""
        avoid = result["avoid"]
        return [
            f"Learned reward: correlation with the optimal value {result['spearman']:.2f} (Spearman) and "
            f"{result['pearson']:.2f} (Pearson), EPIC distance to the true reward {result['epic']:.2f}. The policy "
            f"re-optimised on it enters the avoided colour in {100 * avoid['entered']:.1f} % of episodes; the expert "
            f"in {100 * avoid['expert_entered']:.1f} %."
        ]

    def result_tables(self, result: Result) -> list[TableView]:
        """The normalised return by instruction, of the learned policy and of the policy re-optimised on the reward."""
        rows = tuple(
            (goal, f"{own['return_over_optimal']:.3f}", f"{own['reoptimised_over_optimal']:.3f}")
            for goal, own in result["goals"].items()
        )
        caption = "Return: 1 optimal, 0 random. Re-optimised: by planning on the learned reward"
        return [TableView(caption=caption, head=("instruction", "learned policy", "re-optimised policy"), rows=rows)]

    def success_group(
        self, config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]
    ) -> Group:
        """The normalised return during training, for each instruction."""
        steps = [point["env_steps"] for point in points]
        goals = list(points[0]["returns"])
        charts = [draw_chart(g, [Line(name="return", x=steps, y=[p["returns"][g] for p in points])]) for g in goals]
        words = "Normalised return (1 optimal, 0 random) of the exploring policy, against environment steps."
        return Group(title="Return during training", words=words, charts=tuple(charts))

    def strips(
        self, folder: RunFolder, config: Config, pages: int, display: Display
    ) -> tuple[dict[str, list[EpisodeView]], str]:
        """No episodes: there are no pages."""
        return {}, ""

    def maps(self, folder: RunFolder, config: Config) -> Maps | None:
        """Heat maps of the learned reward on the first layout, one per training instruction."""
        if not ALGORITHMS[config.algorithm].has_learned_reward or not folder.saved:
            return None
        learner = open_run(config, folder.latest_checkpoint()).learner
        layout = layouts_of(config.grid)[0]
        return draw_heat(layout, reward_panels(config, learner, layout, learner.pairs))
