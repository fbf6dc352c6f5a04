"""Warnings about a scene that an array and its frequencies cannot image without doubles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from clradar.arrays.lobes import Lobe, ghosts, range_aliases
from clradar.errors import warn
from clradar.model import AntennaArray, Scene, Waveform
from clradar.tracing.placement import bounding_box_m

LEAST_SPAN = 0.05  # of the sines of a scene's directions; less is no wider than a lobe
PERIODS = 5


def warn_of_ambiguity(scene: Scene, array: AntennaArray, waveform: Waveform) -> None:
    """Warn of a scene beyond the unambiguous range, or as wide as the array's grating lobes.

    That is: the farthest corner of the scene's box appears in front of the antennas, folded by c /
    (2 df), with -12 dB or more of its own amplitude; or a grating lobe of -3 dB or more is no
    farther from its echo than parts of the scene are from each other.
    """
    box_m = bounding_box_m(scene)
    corners_m = np.stack(np.meshgrid(*box_m.T), axis=-1).reshape(-1, 3)
    middle_m = np.concatenate([array.tx_m, array.rx_m]).mean(axis=0)
    away_m = np.linalg.norm(corners_m - middle_m, axis=1)
    _warn_of_range(array, waveform, corners_m[away_m.argmax()], float(away_m.max()))
    centre_m = box_m.mean(axis=0) - middle_m
    towards = (corners_m - middle_m) / np.maximum(away_m, 1e-9)[:, None]
    span = np.ptp(towards, axis=0)[:2]
    if centre_m[2] <= 0 or span.max() < LEAST_SPAN or away_m.min() == 0:
        return
    range_m = float(f"{np.linalg.norm(centre_m):.1g}")
    keys = tuple(np.ceil(span * 20) / 20)
    lobe = _lobe_within(_Radar(array, middle_m, waveform), range_m, keys)
    if lobe is not None:
        warn(
            "simulate: the scene is as wide as the array's grating lobes: parts of it appear at "
            f"others, {abs(lobe.azimuth_deg):.0f} degrees aside and {abs(lobe.elevation_deg):.0f} "
            f"above or below ({lobe.level_db:.1f} dB); space the antennas more closely, or "
            "use some that do not see all of it (clradar array)"
        )


def _warn_of_range(
    array: AntennaArray, waveform: Waveform, at_m: np.ndarray, range_m: float
) -> None:
    period_m = waveform.unambiguous_range_m
    folds = int(min(PERIODS, range_m // period_m)) if period_m > 0 else 0
    found = range_aliases(array, waveform, at_m, range(-1, -folds - 1, -1))
    if found:
        places = [f"{at[2]:.3g} m ({20 * np.log10(level) + 0.0:.1f} dB)" for at, level in found]
        warn(
            f"simulate: the scene reaches to a range of {range_m:.3g} m, beyond the unambiguous "
            f"range c / (2 df) of {period_m:.3g} m: echoes from there appear at "
            f"{' and '.join(places)}, too; take smaller frequency steps"
        )


class _Radar:
    """An array about its middle and its frequencies as a key: equal ones have one hash."""

    def __init__(self, array: AntennaArray, middle_m: np.ndarray, waveform: Waveform) -> None:
        # Copies of a cluster at other places differ by rounding.
        tx_m, rx_m = ((side - middle_m).round(9) + 0.0 for side in (array.tx_m, array.rx_m))
        self.array, self.waveform = AntennaArray(tx_m, rx_m, array.name), waveform
        self._key = (tx_m.tobytes(), rx_m.tobytes(), waveform.frequencies_hz.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Radar) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=16)
def _lobe_within(radar: _Radar, range_m: float, span: tuple[float, ...]) -> Lobe | None:
    """The strongest lobe within a difference of sines; lobes shift with their echo."""

    def near(places_m: np.ndarray) -> np.ndarray:
        return np.asarray((np.abs(places_m[:, :2]) / range_m <= span).all(axis=1))

    antennas_m = np.concatenate([radar.array.tx_m, radar.array.rx_m])
    if range_m <= np.ptp(antennas_m[:, 2]):
        return None
    (found,) = ghosts(radar.array, radar.waveform, np.array([0.0, 0.0, range_m]), near)
    return found[0] if found else None
