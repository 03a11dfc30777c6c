"""Names that code and documents no longer use; CHANGELOG.md says what each became."""

from __future__ import annotations

import re

SETTINGS = r"""
\bdiscriminator\.(chance|judges|trim|slow)\b
\bdemo_states\b
\bfinal_rate\b
(?<!learner\.)\b(discriminator|cloning|soft_q)\.(rename|jitter)\b
\bpolicy\.(asked|taken|value)\b
\bcloning_start\b
\bdemos\.spoiled\b
\bfloor_episodes\b
\bnet\.(beside|neighbours|order|overlap)\b
\bgrid\.(neighbours|order)\b
\bfinal_entropy\b
\bactors\.(silence_s|minimum)\b
\bchance_episodes\b
\bwhole_map\b
"""
COMMANDS_AND_RESULTS = r"""
\breward toggle\b
\brandom floor\b
--at-once\b
--go-on\b
"(asked|elsewhere)\.json"
\bd_accuracy_(chance|demo_states)\b
\bspoiled demonstrations\b
"""
MODULES = r"""
\bgiirl[./](run|cli)_\w+
\bgiirl[./](spec|stopping|oracle|judged|shots|heat|report_page|report_numbers|gridcraft\w*|swaps)\b
\bgiirl[./](actions|columns|config|config_file|delivery|features|files|goals|keys|language|metrics|models)\b
\bgiirl[./](parameters|progress|reward|score_client|scoring|supervision|transport|wire)\b
\bactors[./](choosers|tally)\b
\bbrowser_farm[./](answers|devtools|hub|miniwob|package|place|repair|reaper|recorder|recordings|tabs|wording)\b
\bbrowser_farm/\w+\.js\b
\bexperts[./]sight\b
\blearner[./](account|admission|annealing|examples|grid_nets|grid_steps|gridworld|held|ingest|parts)\b
"""
CODE = r"""
\b(Net|Expert|Random)?Chooser\b
\b(Unrepairable|Judged|Valued)\b
\bclass (Account|Conduct|Half|Held|Member|Package|Sight|Shot|Strip|Stuck|Turn)\b
\bdef (clone|entering_rate|fallen|follow_reward|imitate|paid|reinforce|worth)\(
\.(bury|excuse|fallen|forgive|worth)\(
@plays\(
\bPurpose\.FLOOR\b
\bNEVER\b
\bdelivery\.(BEAT|WHO)\b
\bhas_judged\b
\bwhole_file\b
\bseal_(net|optimiser)\b
\bWeights\.seal\b
\breward_measures\b
\bentering_rate\b
\bdraw: np\.random\.Generator\b
\bnoise: torch\.Generator\b
"""
OLD_NAMES = [re.compile(line) for line in (SETTINGS + COMMANDS_AND_RESULTS + MODULES + CODE).split("\n") if line]
