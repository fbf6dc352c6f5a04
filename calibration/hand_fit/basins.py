"""From places of a hand to the poses in which its fit comes to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.hand_fit.agreement import range_ratio
from calibration.hand_fit.certainty import joints_at
from calibration.hand_fit.descent import COARSE, FINE, LEVELS, MIDDLE, Fitted, HandFitter, Level
from calibration.hand_fit.digit_search import DigitSearch
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.layers import HandSkin
from calibration.hand_fit.prior import Prior
from calibration.hand_fit.result import APART_M, DIGITS, RIVAL_DEVIANCE, ends_apart_m
from calibration.registration.mesh_fit import initial_log_brightness

PLACES = 3  # that are told apart by `APART_M` and tried
SWEEPS = 2
POOL = 3  # states that go down from the search
BESIDE = 4  # poses of single digits that are compared with them where the ranges disagree
DISAGREEING = 1.0  # `range_ratio` of a fit above which a digit may be elsewhere
ROUNDS = (
    (replace(COARSE, surfaces=1), replace(MIDDLE, surfaces=1)),
    (replace(MIDDLE, surfaces=1), replace(FINE, surfaces=1)),
    (replace(FINE, surfaces=3),),
)
"""Levels of a descent; after the last but the first of these two states go on at most."""

WORSE_AFTER = (20.0, RIVAL_DEVIANCE + 4.0)
"""By how much the second may be worse after a round: after a rough one the deviance is still 10 to
20 above where it comes to rest, and as often of either."""

JUDGED_SEED = 1000
"""Added to the seed of the surfaces that a fit is judged on: none of those that it was made on."""


def roughly(
    places: list[HandState], fitter: HandFitter, prior: Prior, seed: int, most: int = PLACES
) -> Fitted:
    """The best coarse fit from places of a hand, of which at most so many are tried."""
    brightness = initial_log_brightness()
    first = replace(COARSE, surfaces=1)
    tried = [
        fitter.descend(place, brightness, prior, (first,), seed)
        for place in distinct(places, fitter)[:most]
    ]
    best = min(tried, key=lambda one: one.deviance)
    rest = replace(COARSE, surfaces=COARSE.surfaces - 1)
    return fitter.descend(best.state, best.log_brightness, prior, (rest,), seed + 1)


def basins_from(
    rough: Fitted, fitter: HandFitter, prior: Prior, skin: HandSkin, seed: int
) -> list[Fitted]:
    """The poses that fits from a coarse one come to rest in, judged on fresh surfaces, best first.

    The digits are searched one by one. The result, that of no search, and poses of single digits
    that picture nearly as well go down together, level by level. Where the ranges of the best
    disagree with the measured ones, the digits are searched again about it, and the last round
    compares the best from there with the best so far. Those that it leaves out are returned, too,
    as much worse as they were before it.
    """

    def down(pool: list[Fitted], number: int) -> list[Fitted]:
        # Every round has surfaces of its own.
        return _refined(pool, fitter, prior, ROUNDS[number], seed + len(LEVELS) * number)

    best, *others = down([rough, *searched(rough, fitter, prior, skin)], 0)
    best, *others = down([best, *_near(best, others[:1], WORSE_AFTER[0])], 1)
    if _ratio(best, fitter, seed + JUDGED_SEED) > DISAGREEING:
        # Not without those near the best: the same tips may be two places to come to rest.
        others += down(beside(best, fitter, prior, skin), 1)
        others.sort(key=lambda one: one.deviance)
    going = [best, *_near(best, others[:1], WORSE_AFTER[1])]
    ended = down(going, 2)
    change = ended[0].deviance - min(one.deviance for one in going)
    left_out = [replace(one, deviance=one.deviance + change) for one in others[len(going) - 1 :]]
    return best_apart([*ended, *left_out], fitter)


def _ratio(found: Fitted, fitter: HandFitter, seed: int) -> float:
    picture = fitter.picture(FINE)
    picture.draw_surface(found.state, seed)
    return range_ratio(picture, picture.render(found.state, found.log_brightness))


def _near(best: Fitted, others: list[Fitted], worse: float) -> list[Fitted]:
    return [one for one in others if one.deviance <= best.deviance + worse]


def _refined(
    pool: list[Fitted], fitter: HandFitter, prior: Prior, levels: tuple[Level, ...], seed: int
) -> list[Fitted]:
    """After a descent, judged on fresh surfaces on the finest pictures, best first, and apart."""
    ended = [fitter.descend(one.state, one.log_brightness, prior, levels, seed) for one in pool]
    return best_apart([fitter.judged(one, prior, seed=seed + JUDGED_SEED) for one in ended], fitter)


def searched(found: Fitted, fitter: HandFitter, prior: Prior, skin: HandSkin) -> list[Fitted]:
    """The state to which sweeps over the digits lead, and those of single digits that come next."""
    search = DigitSearch(fitter, skin, prior, COARSE)
    state = found.state
    for _ in range(SWEEPS):
        before, swept = state, search.sweep(state, found.log_brightness)
        state = swept.state
        if tips_apart_m(before, state, fitter).max() < APART_M:
            break
    other_of: dict[str, HandState] = {}
    for other in sorted(swept.others, key=lambda other: other.worse):
        other_of.setdefault(other.digit, other.state)
    return [
        Fitted(one, found.log_brightness, np.inf, np.inf)
        for one in (state, *list(other_of.values())[: POOL - 2])
    ]


def beside(found: Fitted, fitter: HandFitter, prior: Prior, skin: HandSkin) -> list[Fitted]:
    """The fit with one digit at a time in its best pose elsewhere, on finer pictures."""
    search = DigitSearch(fitter, skin, prior, MIDDLE)
    whole = skin.drawn(found.state.pose, found.state.shape)
    others = []
    for digit in DIGITS:
        tried = search.tried(found.state, found.log_brightness, whole, digit)
        k = tried.best_elsewhere()
        if k is not None:
            worse = float(tried.deviance[k] - tried.deviance[0])
            others.append((worse, found.state.with_angles(tried.angles_rad[k])))
    others.sort(key=lambda other: other[0])
    return [Fitted(state, found.log_brightness, np.inf, np.inf) for _, state in others[:BESIDE]]


def tips_apart_m(one: HandState, other: HandState, fitter: HandFitter) -> np.ndarray:
    """Distances of the tips, (5,), metres; of the last joints where a rig has no tips."""
    return ends_apart_m(joints_at(fitter, one), joints_at(fitter, other))


def best_apart(found: list[Fitted], fitter: HandFitter) -> list[Fitted]:
    """Best first, without those all of whose tips are near those of a better one."""
    kept: list[Fitted] = []
    for one in sorted(found, key=lambda one: one.deviance):
        if all(tips_apart_m(one.state, k.state, fitter).max() > APART_M for k in kept):
            kept.append(one)
    return kept


def distinct(places: list[HandState], fitter: HandFitter) -> list[HandState]:
    """Those whose joints are on average more than `APART_M` from all before."""
    kept: list[HandState] = []
    for place in places:
        here_m = joints_at(fitter, place)
        away_m = [np.nanmean(np.linalg.norm(here_m - joints_at(fitter, k), axis=1)) for k in kept]
        if min(away_m, default=np.inf) > APART_M:
            kept.append(place)
    return kept
