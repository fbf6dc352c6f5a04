"""Warnings of simulations in which too few rays reach the receivers."""

from __future__ import annotations

import numpy as np

from clradar.errors import warn
from clradar.model import AntennaArray, Scene
from clradar.tracing.placement import doubtful
from clradar.tracing.settings import SimulationSettings
from clradar.tracing.suited import RADIUS_RANGE_M, RECEPTION_RADIUS_M, range_m, same_phase_radius_m

STARVED_SHARE = 0.1
"""From this share of pairs without any path on a simulation is starved. Where rays arrive by chance
there are then 2.3 paths per pair, whose shot noise is as strong as 0.66 of the signal."""

STARVED_PATHS = 20.0
"""With this many independent paths on average, over the pairs that have any, it is not: no pair is
left without one by chance. The others are where nothing is reflected to, as beside the mirror image
of a small plate."""

WANTED_PATHS = 20.0  # per pair, which the advice aims at: shot noise of 0.2 of the signal


def warn_if_starved(
    paths: np.ndarray,
    scene: Scene,
    array: AntennaArray,
    settings: SimulationSettings,
    *,
    only_stochastic: bool = False,
) -> None:
    """Warn if no path reached a receiver, or so few that many pairs are zero by chance.

    `paths`, shape (n_tx * n_rx,), has the number of each pair. `only_stochastic`: the function that
    was called has no other estimator.
    """
    total = int(paths.sum())
    if total == 0:
        warn(
            "no ray reached a receiver: the capture is zero everywhere; is the scene in front of "
            "the antennas and sampled densely enough, and does alpha leave a direction to them?"
        )
        return
    empty_share = float(np.mean(paths == 0))
    distance_m = range_m(scene, array)
    alike = 1
    if settings.estimator == "stochastic" and not _spread(scene, settings, distance_m):
        alike = settings.rays_per_sample or 1
    per_reached = total / np.count_nonzero(paths) / alike
    if empty_share < STARVED_SHARE or per_reached >= STARVED_PATHS:
        return
    if doubtful(scene, array) is not None:  # samples do not help, and it was said
        return
    remedies = _remedies(WANTED_PATHS * alike * paths.size / total, settings, distance_m)
    single = settings.estimator == "stochastic" and settings.max_bounces == 1
    if single and not only_stochastic and _spread(scene, settings, distance_m):
        remedies.append("estimator='expected', which has no random directions")
    warn(
        f"{100 * empty_share:.0f} % of the {paths.size} pairs of antennas received no ray and are "
        f"zero, the others {per_reached:.1f} on average: the capture is mostly shot noise. "
        f"Take {', or '.join(remedies)}"
    )


def _spread(scene: Scene, settings: SimulationSettings, distance_m: float) -> bool:
    """Whether the rays of a sample part on their way; else all of them reach the same receivers."""
    return float(np.max(scene.alpha)) * distance_m > settings.radius_m


def _remedies(more: float, settings: SimulationSettings, distance_m: float) -> list[str]:
    """Settings with which about `more` times as many paths arrive."""
    field, now = "samples_per_mm2", settings.samples_per_mm2
    if now is None:
        field, now = "rays_per_face", settings.rays_per_face
    assert now is not None, "settings are resolved"
    found = [f"{field}={_rounded_up(more * now):g} (now {now:g})"]
    radius_m, own_m = same_phase_radius_m(distance_m), settings.radius_m
    if radius_m >= 1.5 * own_m:
        still = max(1.0, more * (own_m / radius_m) ** 2)
        found.append(
            f"{field}={_rounded_up(still * now):g} and reception_radius_m={radius_m:.2g} (now "
            f"{own_m:g}), which at {distance_m:.2g} m has the phase error of "
            f"{RECEPTION_RADIUS_M:g} m at {RADIUS_RANGE_M:g} m"
        )
    return found


def _rounded_up(value: float) -> float:
    """The next number of one significant digit."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / unit) * unit)
