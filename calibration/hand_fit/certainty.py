"""What a measurement tells of a hand: covariance of its parameters and joints, and what it leaves
to the prior.

docs/hand-fit-method.md has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.hand_fit.agreement import range_ratio
from calibration.hand_fit.descent import FALLS, FINE, Fitted, HandFitter
from calibration.hand_fit.hand_rendering import ANGLES, N_GEOMETRY, N_PARAMETERS, SHAPE, stepped
from calibration.hand_fit.hand_shape_vector import SHAPE_NAMES
from calibration.hand_fit.hand_state import FITTED_ANGLES, HandState
from calibration.hand_fit.prior import Prior
from calibration.registration.mesh_fit import SMOOTH
from calibration.registration.rigid_motion import moved

COVARIANCE_RATIO = 1.2
"""Errors in simulations relative to the standard deviations of the measurement alone: residuals are
correlated over more than a resolution cell (docs/hand-fit-method.md)."""

UNTOLD_SHARE = 0.8
"""An angle is undetermined where its own trace lowers its standard deviation by less than to this
share. At 0.8 the value that prior and other angles give it is as exact, in
simulations, as the value fitted: rms 9.4 against 9.5 degrees (docs/hand-fit-method.md)."""

SURFACE_NOISE = 2.0  # by so much the deviance differs between surfaces that are drawn anew
DEVIANCE_PER_E = COVARIANCE_RATIO**2 * np.sqrt(1.0 + np.pi / 8.0 * SURFACE_NOISE**2)
"""Difference of the deviances of two poses that makes one e times as likely: 1 but for what makes
errors larger and, with a normal distribution of this width, for the noise of the surfaces (D.
MacKay, "The evidence framework applied to classification networks", Neural Computation 4, 1992)."""

MOTION_NAMES = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")

GEOMETRY_NAMES = (
    *MOTION_NAMES,
    *(f"{joint} {angle}" for joint, angle in FITTED_ANGLES),
    *(f"shape {name}" for name in SHAPE_NAMES),
)
"""Of the parameters without brightness: radians, metres, logarithms of factors."""


@dataclass(frozen=True, slots=True, eq=False)
class Certainty:
    """What a fit is certain of.

    `covariance`, shape (n, n), of the fitted geometry, and the `names` of its parameters; standard
    deviations `angle_std_rad`, shape (23,); `joint_covariance_m2`, (25, 3, 3); the names of the
    angles that the measurement does not tell, `untold`.
    """

    covariance: np.ndarray
    names: tuple[str, ...]
    angle_std_rad: np.ndarray
    joint_covariance_m2: np.ndarray
    untold: tuple[str, ...]

    @property
    def joint_std_m(self) -> np.ndarray:
        """As `HandFit.joint_std_m`."""
        return np.sqrt(np.trace(self.joint_covariance_m2, axis1=1, axis2=2))


@dataclass(frozen=True, slots=True, eq=False)
class Information:
    """Information at a fit on all parameters, of the measurement and of the prior, (44, 44).

    `fitted`, indices of the parameters that were fitted; `centre_m`, of the twists; `widening`, 1
    or more, by which variances are larger than both say (`agreement.range_ratio`).
    """

    measured: np.ndarray
    before: np.ndarray
    fitted: np.ndarray
    centre_m: np.ndarray
    widening: float = 1.0

    def covariance(self) -> np.ndarray:
        """Of the fitted parameters: (n, n), the brightness among them; not widened."""
        own = np.ix_(self.fitted, self.fitted)
        return np.linalg.inv((self.measured + self.before)[own])

    def told(self) -> np.ndarray:
        """Mask, (23,), of the angles that the measurement tells."""
        own = np.ix_(self.fitted, self.fitted)
        after = np.sqrt(np.diag(self.covariance()))
        shares = np.ones(N_PARAMETERS)
        for place, parameter in enumerate(self.fitted):
            if not ANGLES.start <= parameter < ANGLES.stop:
                continue
            without = self.measured.copy()
            without[parameter] = without[:, parameter] = 0.0
            variance = np.linalg.inv((without + self.before)[own])[place, place]
            shares[parameter] = after[place] / np.sqrt(variance)
        return shares[ANGLES] <= UNTOLD_SHARE


def information_at(fitter: HandFitter, found: Fitted, prior: Prior, seed: int) -> Information:
    """Information at a fit, from freshly drawn surfaces.

    The pattern of the samples would count as information: a finger that turns about itself changes
    nothing else in the rendering. The patterns of two surfaces are independent, and their product
    is unbiased.
    """
    wanted = fitter.fitted.copy()
    wanted[SHAPE] = fitter.model.has_shape
    picture = fitter.picture(FINE)
    slopes, ratios = [], []
    for drawn in (seed, seed + 1):
        picture.draw_surface(found.state, drawn)
        _, rows, centre_m = fitter.linearised(found.state, found.log_brightness, FINE, wanted)
        slopes.append(rows)
        ratios.append(range_ratio(picture, picture.render(found.state, found.log_brightness)))
    product = slopes[0] @ slopes[1].T
    return Information(
        measured=_without_negative(0.5 * (product + product.T)) / COVARIANCE_RATIO**2,
        before=prior.information + SMOOTH * FALLS.T @ FALLS,
        fitted=np.flatnonzero(fitter.fitted),
        centre_m=centre_m,
        widening=max(1.0, float(np.mean(ratios))),
    )


def certainty(
    fitter: HandFitter,
    found: Fitted,
    prior: Prior,
    seed: int,
    known: Information | None = None,
    shape_is_known: bool = True,
) -> Certainty:
    """The covariance at a fit, from information there or near it, widened where ranges disagree.

    The prior's part, too: where whole parts of the surface are elsewhere, neither the minimum nor
    what it was weighed against holds. Where the shape is neither fitted nor known, the spread among
    adults is added.
    """
    known = information_at(fitter, found, prior, seed) if known is None else known
    covariance = known.covariance()
    by_parameter = _joint_derivatives(fitter, found.state, known.centre_m)
    geometry = known.fitted < N_GEOMETRY
    own = known.fitted[geometry]
    inner = covariance[np.ix_(geometry, geometry)]
    angles = (own >= ANGLES.start) & (own < ANGLES.stop)
    if fitter.model.has_shape and SHAPE.start not in own and not shape_is_known:
        # What the fitted parameters take on for each wrong number of the shape.
        taken = (covariance @ known.measured[known.fitted, SHAPE])[geometry]
        spread = np.linalg.inv(prior.information[SHAPE, SHAPE])
        inner = inner + taken @ spread @ taken.T
        rest = by_parameter[SHAPE] - np.einsum("kl,kjc->ljc", taken, by_parameter[own])
        of_shape = np.einsum("kjc,kl,ljd->jcd", rest, spread, rest)
    else:
        of_shape = np.zeros((25, 3, 3))
    fitted_part = covariance[np.ix_(geometry, geometry)]
    of_joints = np.einsum("kjc,kl,ljd->jcd", by_parameter[own], fitted_part, by_parameter[own])
    names = tuple(GEOMETRY_NAMES[k] for k in own)
    inner = known.widening * inner
    return Certainty(
        covariance=inner,
        names=names,
        angle_std_rad=np.sqrt(np.diag(inner))[angles],
        joint_covariance_m2=known.widening * (of_joints + of_shape),
        untold=tuple(
            name
            for name, told in zip(GEOMETRY_NAMES[ANGLES], known.told(), strict=True)
            if not told
        ),
    )


def leaving_untold(
    fitter: HandFitter, found: Fitted, prior: Prior, known: Information, seed: int
) -> Fitted:
    """The fit with the angles that the measurement does not tell at the prior's values.

    Those are the means of the prior given the other angles, which follow to where they are best
    then. Where the measurement contradicts, nothing changes.
    """
    told = known.told()
    away = found.state.angles_rad - prior.mean_rad
    inner = prior.information[ANGLES, ANGLES]
    wanted = away.copy()
    wanted[~told] = -np.linalg.solve(
        inner[np.ix_(~told, ~told)], inner[np.ix_(~told, told)] @ away[told]
    )
    step = np.zeros(N_PARAMETERS)
    step[ANGLES] = wanted - away
    held = np.zeros(N_PARAMETERS, dtype=bool)
    held[ANGLES] = ~told
    moving = np.setdiff1d(known.fitted, np.flatnonzero(held))
    total = known.measured + known.before
    pull = total[np.ix_(moving, held)] @ step[held]
    step[moving] = -np.linalg.solve(total[np.ix_(moving, moving)], pull)
    left = replace(found, state=stepped(found.state, step[:N_GEOMETRY], known.centre_m))
    left = fitter.judged(left, prior, seed=seed)
    return left if left.deviance < found.deviance + SURFACE_NOISE else found


def with_spread(
    covariance: np.ndarray, values: np.ndarray, others: Sequence[tuple[np.ndarray, float]]
) -> np.ndarray:
    """Covariances, (n, d, d), of values, (n, d), with other solutions as likely as they are.

    `others` are values, (n, d), and by how much their deviance is larger, minus their log
    likelihood. The spread is about the values given.
    """
    more = np.array([0.0, *(more for _, more in others)])
    weights = np.exp(-np.maximum(more, 0.0) / DEVIANCE_PER_E)
    weights /= weights.sum()
    apart = [other - values for other, _ in others]
    spread = sum(
        (w * np.einsum("nc,nd->ncd", a, a) for w, a in zip(weights[1:], apart, strict=True)),
        np.zeros_like(covariance),
    )
    return covariance + spread


def joints_at(fitter: HandFitter, state: HandState) -> np.ndarray:
    """Joints in the antenna frame, (25, 3), metres."""
    return moved(state.transform, fitter.model.joints_m(state.pose, state.shape))


def _without_negative(matrix: np.ndarray) -> np.ndarray:
    """The nearest matrix without negative eigenvalues, each parameter in its own unit."""
    unit = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(unit, unit))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(unit, unit)


def _joint_derivatives(fitter: HandFitter, state: HandState, centre_m: np.ndarray) -> np.ndarray:
    """Derivatives of the joints by the geometry's parameters, (37, 25, 3)."""
    here_m = joints_at(fitter, state)
    rows = []
    for step in 1e-4 * np.eye(N_GEOMETRY):
        there_m = joints_at(fitter, stepped(state, step, centre_m))
        if (np.nan_to_num(there_m) == np.nan_to_num(here_m)).all():  # at its limit
            step = -step
            there_m = joints_at(fitter, stepped(state, step, centre_m))
        rows.append((there_m - here_m) / step.sum())
    return np.array(rows)
