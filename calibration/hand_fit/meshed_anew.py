"""The last steps of a fit, with slopes of surfaces that are meshed anew.

The samples of one surface move with their bones, and what is visible stays so. But a finger covers
another one, and skin meets skin where a hand grows thicker: slopes without that lead to a hand that
is too thin, with a deviance up to 6 higher (docs/hand-fit-method.md). What they miss is found once,
changing every parameter in turn, and holds near that state: for all steps here, and for those of
fits to simulations of the same hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.hand_fit.descent import BRIGHTNESS, FINE, Fitted, HandFitter, Missed
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY, SHAPE, stepped
from calibration.hand_fit.hand_shape_vector import vector_of
from calibration.hand_fit.hand_state import HandState
from calibration.hand_fit.prior import Prior
from calibration.registration.mesh_fit import POWER_FLOOR

_ANGLE_STEP_RAD, _SHAPE_STEP = 0.05, 0.025
"""They move a fingertip by some millimetres: more than the spacing of the samples."""

_MOST_STEPS, _SHARES = 4, (1.0, 0.5, 0.25)

_SETTLED = 0.1  # a fall of the deviance below which no further step is tried


def missed_slopes(fitter: HandFitter, found: Fitted, seed: int) -> Missed:
    """What slopes of moving samples miss near a fit, of the parameters that are fitted."""
    picture, state, log_brightness = fitter.picture(FINE), found.state, found.log_brightness
    picture.draw_surface(state, seed)
    power, _ = picture.render(state, log_brightness)
    missed = np.zeros((2, N_GEOMETRY, power.size))
    for k in range(ANGLES.start, N_GEOMETRY):
        if not fitter.fitted[k]:
            continue
        step = np.zeros(N_GEOMETRY)
        step[k] = _ANGLE_STEP_RAD if k < SHAPE.start else _SHAPE_STEP
        ends = [stepped(state, way * step, np.zeros(3)) for way in (1.0, -1.0)]
        bends = [_bent(end, state, k) for end in ends]
        which = int(abs(bends[1]) > abs(bends[0]))  # at a limit one of them stays
        anew = picture.meshed_anew(ends[which], log_brightness, seed)
        moved = picture.render(ends[which], log_brightness)
        missed[:, k] = np.subtract(anew, moved).reshape(2, -1) / bends[which]
    return Missed(missed[0] / (power.ravel() + POWER_FLOOR), missed[1])


def settled(fitter: HandFitter, found: Fitted, prior: Prior, missed: Missed, seed: int) -> Fitted:
    """The fit after steps with what was missed, each judged on a surface that is meshed anew."""
    best = fitter.judged(found, prior, seed=seed)
    for _ in range(_MOST_STEPS):
        before = best
        step, centre_m = fitter.step(before, prior, missed)
        for share in _SHARES:
            ahead = replace(
                before,
                state=stepped(before.state, share * step[:N_GEOMETRY], centre_m),
                log_brightness=before.log_brightness + share * step[BRIGHTNESS],
            )
            tried = fitter.judged(ahead, prior, seed=seed)
            if tried.deviance < before.deviance:
                best = tried
                break
        if before.deviance - best.deviance < _SETTLED:
            break
    return best


def _bent(there: HandState, here: HandState, k: int) -> float:
    """By how much an angle or a number of the shape differs."""
    if k < SHAPE.start:
        return float((there.angles_rad - here.angles_rad)[k - ANGLES.start])
    return float((vector_of(there.shape) - vector_of(here.shape))[k - SHAPE.start])
