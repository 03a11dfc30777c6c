"""The studies of the tabular chapter by name; the command line has their help under the same names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from giirl.studies.grid_ablations import gridcraft_ablations
from giirl.studies.grid_figures import figure_4_3, figure_4_4
from giirl.studies.grid_joint import gridcraft_joint
from giirl.studies.grid_maxent import gridcraft_maxent
from giirl_core.progress import Display

STUDIES: dict[str, Callable[[int, Path, Display], dict[str, Any]]] = {  # (seeds, folder for figures, display) -> result
    "figure-4.3": figure_4_3,
    "figure-4.4": figure_4_4,
    "gridcraft-joint": gridcraft_joint,
    "gridcraft-maxent": gridcraft_maxent,
    "gridcraft-ablations": gridcraft_ablations,
}
