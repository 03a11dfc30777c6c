"""A run on web pages from config to result: demonstrations, training, checkpoints, evaluation."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from threading import Event
from typing import Any

import torch

from actors.browser import measured_tasks
from actors.pool import player_for
from giirl.run.demonstrations import collect_demonstrations
from giirl.run.evaluate import evaluate
from giirl.run.folder import RunFolder
from giirl.run.serial import Runtime, SerialRuntime
from giirl.run.workers import WorkersRuntime
from giirl.signals import Stopped, raise_if, stopping
from giirl.statistics import WINDOW, lowest_window
from giirl.throughput import Throughput, format_rates, format_success
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.metrics import Metrics
from giirl_core.processes.open_files import raise_open_files
from giirl_core.progress import Display, Job
from giirl_core.telemetry.logs import configure_logs
from giirl_core.telemetry.targets import clear_dead_targets, reachable, write_targets
from giirl_core.types import Episode, Trajectory
from giirl_core.weights import Weights
from learner.algorithms import LOOPS
from learner.checkpoint import save_checkpoint
from learner.data import with_env_reward
from learner.devices import device_memory_bytes, learner_device, learner_threads
from learner.feedback import Feedback
from learner.learner import Learner

COUNTS = "counts.json"  # in a checkpoint
LONG_ITERATION_S = 1.5  # Ray kills a job 3 s after it was asked to stop


def train(config: Config, folder: RunFolder, resume: Path | None, display: Display) -> dict[str, Any]:
    """Train to the end, evaluate, and return the result.

    Raises Stopped after Ctrl-C, SIGTERM or SIGHUP, with a checkpoint saved.
    """
    since_s = time.monotonic()
    metrics, stop = Metrics("learner"), Event()
    torch.set_num_threads(learner_threads(config))
    configure_logs(config.log, folder.identity, "learner")
    if config.runtime != "serial":
        raise_open_files(folder.wanted_actors() or config.actors.count)
    own = metrics.serve(config.metrics.host, config.metrics.port)
    open_player = player_for(config, folder.identity)
    try:
        clear_dead_targets(folder.path.parent)
        if resume is None:
            metrics.enter("demonstrations")
            config, episodes = collect_demonstrations(config, metrics, display, open_player)
            folder.save_config(config)
            folder.save_demonstrations(episodes)
        demonstrations = [episode.trajectory for episode in folder.load_demonstrations()]
        learner = Learner(config, demonstrations, metrics)
        if resume is not None:
            learner.load(resume)
        else:
            if ALGORITHMS[config.algorithm].reward == "frozen":
                learner.load_reward(reward_of_run(Path(config.reward_from)))
            _warm_up(learner, config.policy.bc_warmup_updates, display)
        session = Session(config, folder, learner, metrics, stop, own, display)
        with stopping(stop):
            session.learn(resume)
        policy, _ = learner.weights()
        metrics.enter("evaluation")
        tasks = evaluate(config, policy, metrics, display, open_player, demonstrations)
    finally:
        metrics.close()
    return {
        "tasks": tasks,
        "env_steps": session.env_steps,
        "seconds": round(session.seconds_before + time.monotonic() - since_s, 1),
        "algorithm": config.algorithm,
        "seed": config.seed,
        "training_episodes": session.episodes,
        "demonstrations": {task: sum(d.task == task for d in demonstrations) for task in config.tasks},
        "lowest_last_third": session.lowest_last_third(),
        "flow": {**session.throughput.total(), "service_reward_share": learner.discriminator.service_share},
        "parameters_sha256": learner.hash(),
    }


def _warm_up(learner: Learner, updates: int, display: Display) -> None:
    """Start from behavioural cloning, if the config asks for it."""
    if not updates:
        return
    with display.job("behavioural cloning", updates) as job:
        for stats in learner.bc_warmup():
            job.advance(note=f"loss {stats['p_loss']:.3f}")


class Session:
    """The source of rollouts and the observer of one training loop: publishes weights, reports and saves."""

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        learner: Learner,
        metrics: Metrics,
        stop: Event,
        own_address: str,
        display: Display,
    ) -> None:
        self._config, self._folder, self._learner, self._metrics = config, folder, learner, metrics
        self._stop, self._own_address, self._display = stop, own_address, display
        self._runtime: Runtime | None = None
        self._job: Job | None = None
        self._feedback = Feedback(folder.feedback, config, learner.vectors)
        self._rollouts: list[Episode] = []  # of the current step
        self._consistent = True  # False between take and observe, when a checkpoint would lose rollouts
        self._targets: dict[str, str] = {}
        self._recent = {task: deque[int](maxlen=WINDOW) for task in measured_tasks(config)}
        self.throughput = Throughput()
        self._since_s = self._taken_s = time.monotonic()
        self.seconds_before = 0.0  # of the sessions before this one was resumed
        self.env_steps = 0  # in the episodes that the learner took
        self.episodes = 0

    def learn(self, resume: Path | None) -> None:
        """Train from the learner's version to `iterations`, and return when the runtime is closed."""
        config, learner, metrics = self._config, self._learner, self._metrics
        self._folder.cut_curve(learner.version)
        device = learner_device(config).type
        metrics.begin(self._folder.identity, config.algorithm, device, learner.version, config.iterations)
        if resume is not None:
            counts = json.loads((resume / COUNTS).read_bytes())
            self.env_steps, self.episodes = counts["env_steps"], counts["episodes"]
            self.seconds_before = counts["seconds"]
            metrics.checkpoint_time.set((resume / COUNTS).stat().st_mtime)
        if learner.version >= config.iterations:
            return
        with self._display.busy(f"starting the {config.runtime} runtime"):
            save = self._save_if_consistent
            self._runtime = open_runtime(config, self._folder, metrics, self._stop, resume, save)
        self._own_address = reachable(self._own_address, self._runtime.node)
        try:
            workers = config.runtime != "serial"
            with self._display.busy("starting actors and reward service") if workers else nullcontext():
                self._runtime.publish(*learner.weights())
            self._update_targets()
            if resume is None:
                self._save()  # now the run can be resumed
            metrics.enter("training")
            with self._display.job("training", config.iterations, learner.version) as self._job:
                LOOPS[config.algorithm](config, learner, self, self._steps(), self._observe)
            raise_if(self._stop)
            self._end()
        except Stopped:
            self._save()  # first: whoever asked to stop may kill this process soon
            self._end()
            raise
        except RuntimeError as error:
            with suppress(OSError):  # an older checkpoint is there
                self._save_if_consistent()
            raise RuntimeError(f"{error}{self._folder.way_on}") from error
        finally:
            self._runtime.close()
            with suppress(OSError):  # there is no process to scrape any more, whether the file says so or not
                write_targets(self._folder.targets, [])

    def take(self, episodes: int) -> list[Trajectory]:
        """Rollouts for the training loop. Their outcomes stay here and are only reported."""
        assert self._runtime is not None
        with self.throughput.waiting():
            self._rollouts = self._runtime.take(episodes)
        if not self._rollouts:
            raise Stopped
        self._consistent, self._taken_s = False, time.monotonic()
        if ALGORITHMS[self._config.algorithm].reward == "environment":
            return [with_env_reward(episode) for episode in self._rollouts]
        return [episode.trajectory for episode in self._rollouts]

    def lowest_last_third(self) -> dict[str, float | None]:
        """For each task, the lowest success of WINDOW consecutive training episodes in the last third of the run."""
        points = [p for p in self._folder.points() if p["step"] > 2 * self._config.iterations / 3]
        return {
            task: lowest_window([bool(o) for p in points for o in p["outcomes"].get(task, [])], WINDOW)
            for task in self._config.tasks
        }

    def _steps(self) -> Iterator[int]:
        for step in range(self._learner.version, self._config.iterations):
            raise_if(self._stop)
            self._learner.anneal(step)
            if (heard := self._feedback.read()) is not None:
                self._learner.hear(heard)
                self._display.say(f"answers of people that the run learns from: {len(self._feedback)}")
            yield step

    def _observe(self, step: int, stats: dict[str, float]) -> None:
        """Publish the weights, append to the curve, and save when a checkpoint is due."""
        assert self._runtime is not None
        assert self._job is not None
        self._learner.version, self._consistent = step + 1, True
        # A stop in a long iteration may not find the time to wait for its end, so the last one has to be saved.
        long = time.monotonic() - self._taken_s > LONG_ITERATION_S
        self.env_steps += sum(len(episode.trajectory) for episode in self._rollouts)
        self.episodes += len(self._rollouts)
        won = [(episode.trajectory.task, int(episode.outcome.success)) for episode in self._rollouts]
        outcomes = {task: [success for name, success in won if name == task] for task in self._recent}
        lags = [step - episode.trajectory.policy_version for episode in self._rollouts]
        self.throughput.add(lags, sum(len(episode.trajectory) for episode in self._rollouts), self._runtime.stream())
        rates = self.throughput.recent()
        numbers = {k: round(v, 4) for k, v in stats.items()}
        self._folder.append_curve({**self._counts(), "outcomes": outcomes, **numbers, "flow": rates})
        self._runtime.publish(*self._learner.weights())
        self._metrics.end_iteration(step + 1, numbers, rates, device_memory_bytes())
        self._job.advance(1, f"{self._recent_success(outcomes)}; {format_rates(rates, self._metrics.dropped())}")
        self._update_targets()
        if long or (step + 1) % self._config.checkpoint_every == 0 or step + 1 == self._config.iterations:
            self._save()

    def _counts(self) -> dict[str, float]:
        seconds = round(self.seconds_before + time.monotonic() - self._since_s, 1)
        step = self._learner.version
        return {"step": step, "env_steps": self.env_steps, "episodes": self.episodes, "seconds": seconds}

    def _recent_success(self, outcomes: dict[str, list[int]]) -> str:
        """Success of the exploring policy over the last WINDOW episodes, task by task."""
        for task, some in outcomes.items():
            self._recent[task].extend(some)
        success = {task: sum(some) / len(some) for task, some in self._recent.items() if some}
        for task, share in success.items():
            self._metrics.success.labels(task).set(share)
        return f"success {format_success(success)}"

    def _save(self) -> None:
        runtime = self._runtime
        assert runtime is not None

        def write(partial: Path) -> None:
            self._learner.save(partial)
            runtime.save(partial)
            (partial / COUNTS).write_text(json.dumps(self._counts()), encoding="utf-8")
            (partial / self._folder.config_file.name).write_text(dump_config(self._config), encoding="utf-8")

        with self._metrics.checkpoint_duration.time():
            save_checkpoint(self._folder.checkpoints, self._learner.version, write, keep=self._config.keep_checkpoints)
        self._metrics.checkpoint_time.set_to_current_time()
        runtime.committed()

    def _end(self) -> None:
        """Collect what the actors have finished, and save it."""
        assert self._runtime is not None
        if self._runtime.drain():
            self._save()
            self._runtime.forget()

    def _save_if_consistent(self) -> None:
        """Save while waiting for rollouts, unless that would lose some."""
        if self._consistent:
            self._save()

    def _update_targets(self) -> None:
        """Write the metrics addresses when they have changed, and print new ones."""
        assert self._runtime is not None
        targets = {"learner": self._own_address, **self._runtime.addresses()}
        if targets != self._targets:
            write_targets(self._folder.targets, self._metrics.announce(self._folder.identity, targets))
            for name in targets.keys() - self._targets.keys():
                self._display.say(f"metrics of {name}: http://{targets[name]}/metrics")
            self._targets = targets


def reward_of_run(path: Path) -> Weights:
    """The learned reward of a run, from its last checkpoint; ValueError if it learned none."""
    folder, config = RunFolder.open(path)
    if not ALGORITHMS[config.algorithm].has_learned_reward:
        raise ValueError(f"{path} learned no reward: its algorithm is {config.algorithm!r}, wanted giirl or frozen")
    return folder.weights(folder.latest_checkpoint(), "reward")


def open_runtime(
    config: Config, folder: RunFolder, metrics: Metrics, stop: Event, resume: Path | None, save: Callable[[], None]
) -> Runtime:
    """The runtime that the config names. Ray is imported only when it is used."""
    if config.runtime == "serial":
        return SerialRuntime(config, metrics, resume)
    from giirl_core.processes.ray_platform import RayPlatform

    platform = RayPlatform(config, folder.identity)
    return WorkersRuntime(config, folder, platform, metrics, stop, resume, save)
