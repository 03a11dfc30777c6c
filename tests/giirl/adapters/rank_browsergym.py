"""How a trained reward ranks a click on every element of recorded pages of BrowserGym.

python -m tests.giirl.adapters.rank_browsergym REWARD [--json FILE], where REWARD is a run or an exported file.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Sequence
from typing import Any

import click
import numpy as np

from giirl import LearnedReward
from giirl.adapters.browsergym import read_observation, score_candidates
from giirl_core.files import writable, write_json
from tests.giirl.adapters.record_browsergym import FIXTURE

TAGS = {"click-button": "button", "click-link": "span"}  # of what the goal names


def rank(reward: LearnedReward, observations: Sequence[dict[str, Any]], tag: str) -> dict[str, Any]:
    """How often the best candidate is on an element that the goal names, and by how much it is better than others."""
    margins, candidates = [], []
    for observation in observations:
        seen = read_observation(observation)
        named = observation["goal"].split('"')[1]
        bids = [bid for bid in seen.bids if bid]
        texts = zip(seen.bids, seen.page.tag, seen.page.text, strict=True)
        right = {bid for bid, its, text in texts if (its, text) == (tag, named)}
        scores = score_candidates(reward, observation, [f"click('{bid}')" for bid in bids])
        by_bid = {bid: score for bid, score in zip(bids, scores, strict=True) if score is not None}
        best_other = max(score for bid, score in by_bid.items() if bid not in right)
        margins.append(max(by_bid[bid] for bid in right) - best_other)
        candidates.append(len(bids))
    return {
        "pages": len(margins),
        "candidates_mean": round(float(np.mean(candidates)), 1),
        "right_first": sum(margin > 0 for margin in margins),
        "margin_min": round(min(margins), 2),
        "margin_mean": round(float(np.mean(margins)), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("reward", help="a run, or an exported file")
    parser.add_argument("--json", type=writable)
    given = parser.parse_args()
    reward = LearnedReward(given.reward)
    rows = json.loads(gzip.decompress(FIXTURE.read_bytes()))
    found = {
        task: rank(reward, [r["observation"] for r in rows if r["task"] == task], tag) for task, tag in TAGS.items()
    }
    result = {"reward_version": reward.version, "form": reward.form, "tasks": found}
    if given.json:
        write_json(given.json, result)
    click.echo(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
