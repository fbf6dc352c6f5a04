"""What a mesh looks like to the radar, in a millisecond: brightness and range of every pixel.

No phases: each visible sample of the surface adds its brightness through the power pattern of the
array. That has neither speckle nor interference, and is smooth in the place of the mesh, which is
what a fit needs. `docs/calibration.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from calibration.registration.rigid_motion import moved
from clradar.constants import SPEED_OF_LIGHT_M_PER_S
from clradar.model import AntennaArray, DepthMap
from clradar.tracing.visible_surface import VisibleSurface

KNOTS_RAD = np.radians([0.0, 8.0, 16.0, 24.0, 36.0, 50.0, 70.0])
"""Angles between line of sight and normal at which the brightness of the surface is a parameter:
close together where a smooth surface drops from a glint to nothing. Log-linear between them."""

PATTERN_HALF_WIDTH_M = 24e-3
"""How far out the power pattern is carried: five sidelobes of the 94 x 94 imager."""

VIEWS = 3
"""Visibility is asked from a square of so many by so many points over the aperture, less the
middle one: eight, what the kernel takes at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A depth map as the fit reads it.

    Attributes
    ----------
    x_m, y_m : ndarray, metres
        Pixel centres, evenly spaced, `step_m` apart along either axis.
    power : ndarray, shape (n_y, n_x), float64
        Squared amplitude, 1 at the maximum.
    range_m : ndarray, shape (n_y, n_x), float64, metres
        Distance of the depth point from the centre of the aperture, NaN where there is none.
    step_m : tuple of two floats, metres
        Spacing along x and y.
    """

    x_m: np.ndarray
    y_m: np.ndarray
    power: np.ndarray
    range_m: np.ndarray
    step_m: tuple[float, float]

    @classmethod
    def of(cls, depth: DepthMap, step_m: float, centre_m: np.ndarray) -> Picture:
        """Return every k-th pixel of a depth map, about `step_m` apart."""
        thin = thinned(depth, step_m)
        power = thin.amplitude.astype(np.float64) ** 2
        x, y = np.meshgrid(thin.x_m - centre_m[0], thin.y_m - centre_m[1])
        z = thin.depth_m - centre_m[2]
        return cls(
            x_m=thin.x_m,
            y_m=thin.y_m,
            power=power / power.max(),
            range_m=np.sqrt(x**2 + y**2 + z**2),
            step_m=(_spacing(thin.x_m), _spacing(thin.y_m)),
        )


def thinned(depth: DepthMap, step_m: float) -> DepthMap:
    """Return every k-th pixel of a depth map whose pixels are evenly spaced."""
    columns, rows = (
        slice(None, None, max(1, round(step_m / _spacing(axis_m))))
        for axis_m in (depth.x_m, depth.y_m)
    )
    return DepthMap(
        depth.depth_m[rows, columns],
        depth.amplitude[rows, columns],
        depth.x_m[columns],
        depth.y_m[rows],
        depth.dynamic_range_db,
    )


def _spacing(axis_m: np.ndarray) -> float:
    return float((axis_m[-1] - axis_m[0]) / (len(axis_m) - 1))


Pixels = tuple[np.ndarray, np.ndarray]
"""Two images, (n_y, n_x): power, and mean range or power times range."""


class Aperture:
    """What the fit has to know about the radar: where it is, where it looks from, how it blurs."""

    def __init__(self, array: AntennaArray, centre_frequency_hz: float) -> None:
        antennas_m = np.concatenate([array.tx_m, array.rx_m])
        low, high = antennas_m.min(axis=0), antennas_m.max(axis=0)
        self.array = array
        self._cells_m2: dict[float, float] = {}
        self.centre_m = 0.5 * (low + high)
        self.wavelength_m = SPEED_OF_LIGHT_M_PER_S / centre_frequency_hz
        share = np.linspace(0.0, 1.0, VIEWS)
        grid = np.array([(u, v) for u in share for v in share if (u, v) != (0.5, 0.5)])
        # The extremes of a plane array: 0.97 of it keeps rays off antennas that stand alone.
        spread = 0.5 + 0.97 * (grid - 0.5)
        self.views_m = np.concatenate(
            [low[:2] + spread * (high - low)[:2], np.full((len(grid), 1), self.centre_m[2])], axis=1
        )

    def power_pattern(self, range_m: float, step_m: Sequence[float]) -> np.ndarray:
        """Return the response to a point at boresight, shape (n_y, n_x), odd, with sum 1.

        At the centre frequency alone: within the half width the bandwidth changes it little.
        """
        x, y = (
            np.arange(-(n := int(PATTERN_HALF_WIDTH_M / step)), n + 1) * step for step in step_m
        )
        grid_x, grid_y = np.meshgrid(x, y)
        points_m = np.stack([grid_x, grid_y, np.full_like(grid_x, range_m)], axis=-1)
        points_m = points_m.reshape(-1, 3) + self.centre_m
        middle_m = self.centre_m + np.array([0.0, 0.0, range_m])
        response = np.ones(len(points_m), dtype=np.complex128)
        for antennas_m in (self.array.tx_m, self.array.rx_m):
            # One axis at a time: points x antennas x 3 would be the largest array of a fit.
            there = sum((points_m[:, k, None] - antennas_m[:, k]) ** 2 for k in range(3))
            here = ((middle_m - antennas_m) ** 2).sum(axis=1)
            turns = (np.sqrt(there) - np.sqrt(here)) / self.wavelength_m
            response *= np.exp(2j * np.pi * turns).mean(axis=1)
        power = (np.abs(response) ** 2).reshape(grid_x.shape)
        return power / power.sum()

    def cell_m2(self, range_m: float) -> float:
        """Return the area of a resolution cell, in which pixels share their speckle.

        The integral of the speckle's squared correlation, which for a uniform aperture is the power
        pattern itself.
        """
        key = round(range_m, 3)
        if key not in self._cells_m2:
            step_m = 1e-3
            pattern = self.power_pattern(key, (step_m, step_m))
            self._cells_m2[key] = float(step_m**2 * pattern.sum() / pattern.max())
        return self._cells_m2[key]


class MeshImage:
    """The picture of a mesh on given pixels, for any place of the mesh.

    Parameters
    ----------
    surface : VisibleSurface
        Of the mesh where it is; entered.
    picture : Picture
        Whose pixels to use.
    aperture : Aperture
    blur_m : float, metres
        Standard deviation of a further Gaussian blur, for a wider basin at the start.
    """

    def __init__(
        self, surface: VisibleSurface, picture: Picture, aperture: Aperture, blur_m: float = 0.0
    ) -> None:
        self.surface, self.picture, self.aperture = surface, picture, aperture
        self.reference_m = float(np.nanmedian(picture.range_m))
        self._seen = np.zeros(0, dtype=np.intp)
        self._share = np.zeros(0)
        pattern = aperture.power_pattern(self.reference_m, picture.step_m)
        self._half = (pattern.shape[0] // 2, pattern.shape[1] // 2)
        shape = picture.power.shape
        self._padded = tuple(
            fft.next_fast_len(n + 2 * h, real=True) for n, h in zip(shape, self._half, strict=True)
        )
        soft = np.ones(1)
        if blur_m > 0.0:
            step_x, step_y = picture.step_m
            along_y = np.fft.fftfreq(self._padded[0], step_y)[:, None]
            along_x = np.fft.rfftfreq(self._padded[1], step_x)[None, :]
            soft = np.exp(-2.0 * (np.pi * blur_m) ** 2 * (along_x**2 + along_y**2))
        self._pattern = fft.rfft2(pattern, self._padded) * soft
        self.power = picture.power
        if blur_m > 0.0:
            spectrum = fft.rfft2(picture.power, self._padded) * soft
            blurred = fft.irfft2(spectrum, self._padded)[: shape[0], : shape[1]]
            self.power = np.maximum(blurred, 0.0) / blurred.max()

    def look(self, transform: np.ndarray, every: slice = slice(None)) -> None:
        """Find out which samples are seen when the mesh is moved by `transform`, shape (4, 4).

        `every` thins the samples: two halves are two independent drawings of the surface.
        """
        there = moved(np.linalg.inv(transform), self.aperture.views_m)
        share = self.surface.visible_from(there).mean(axis=1)
        self._seen = np.flatnonzero(share > 0)[every]
        self._share = share[self._seen]

    @property
    def n_seen(self) -> int:
        return len(self._seen)

    def seen_points_m(self, transform: np.ndarray) -> np.ndarray:
        """Return the visible samples where they are after `transform`, shape (n, 3), metres."""
        return moved(transform, self.surface.points_m[self._seen])

    def of(self, transform: np.ndarray, log_brightness: np.ndarray) -> Pixels:
        """Return power and mean range of every pixel, both (n_y, n_x); range is in metres.

        Parameters
        ----------
        transform : ndarray, shape (4, 4)
            Where the mesh goes; small steps from where `look` was called.
        log_brightness : ndarray, shape (n_knots,)
            Natural logarithm of the power per area at `KNOTS_RAD`.
        """
        points_m, from_centre_m, angle = self._seen_at(transform)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        return self._pictures(points_m, from_centre_m, bright[None])[0]

    def by_brightness(self, transform: np.ndarray, log_brightness: np.ndarray) -> list[Pixels]:
        """Return the derivatives of power and of power x range by each knot's logarithm."""
        points_m, from_centre_m, angle = self._seen_at(transform)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        shares = [np.interp(angle, KNOTS_RAD, row) for row in np.eye(len(KNOTS_RAD))]
        return self._pictures(points_m, from_centre_m, bright * np.array(shares), mean=False)

    def _seen_at(self, transform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        points_m = self.seen_points_m(transform)
        normals = self.surface.normals[self._seen] @ transform[:3, :3].T
        sight_m = points_m - self.aperture.centre_m
        from_centre_m = np.linalg.norm(sight_m, axis=1)
        cosine = np.abs((normals * sight_m).sum(axis=1)) / from_centre_m
        return points_m, from_centre_m - self.reference_m, np.arccos(np.minimum(cosine, 1.0))

    def _pictures(
        self,
        points_m: np.ndarray,
        range_m: np.ndarray,
        brightness: np.ndarray,
        mean: bool = True,
    ) -> list[Pixels]:
        """Return power and (mean) range for each row of `brightness`, (k, n_samples)."""
        n_y, n_x = self.picture.power.shape
        step_x, step_y = self.picture.step_m
        u = (points_m[:, 0] - self.picture.x_m[0]) / step_x
        v = (points_m[:, 1] - self.picture.y_m[0]) / step_y
        left, low = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        inside = (left >= 0) & (left < n_x - 1) & (low >= 0) & (low < n_y - 1)
        right_share, high_share = (u - left)[inside], (v - low)[inside]
        pixel = (low * n_x + left)[inside]
        corners = [
            (pixel, (1 - right_share) * (1 - high_share)),
            (pixel + 1, right_share * (1 - high_share)),
            (pixel + n_x, (1 - right_share) * high_share),
            (pixel + n_x + 1, right_share * high_share),
        ]
        pictures: list[Pixels] = []
        for row in brightness[:, inside]:
            drawn = np.zeros((2, n_y, n_x))
            for values, target in zip((row, row * range_m[inside]), drawn, strict=True):
                for place, share in corners:
                    target += np.bincount(place, values * share, n_y * n_x).reshape(n_y, n_x)
            spectrum = fft.rfft2(drawn, self._padded) * self._pattern
            h, w = self._half
            power, moment = fft.irfft2(spectrum, self._padded)[:, h : h + n_y, w : w + n_x]
            if mean:
                power = np.maximum(power, 1e-12)
                moment = self.reference_m + moment / power
            pictures.append((power, moment))
        return pictures
