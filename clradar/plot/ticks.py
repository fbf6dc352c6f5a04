"""Ticks of images."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator


class InnerTicks(MaxNLocator):
    """Round values, a share `away` of the axis from its ends: labels of neighbours do not touch."""

    def __init__(self, away: float) -> None:
        super().__init__("auto", steps=[1, 2, 5, 10], min_n_ticks=1)
        self._away = away

    def tick_values(self, vmin: float, vmax: float) -> Any:
        low, high = sorted((vmin, vmax))
        away = self._away * (high - low)
        inner = [v for v in super().tick_values(low, high) if low + away <= v <= high - away]
        return np.array(inner or [(low + high) / 2])
