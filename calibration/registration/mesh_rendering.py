"""Incoherent rendering of a mesh: visible surface samples convolved with a point spread function.

Brightness and range of every pixel in a millisecond. Without phases there is neither speckle nor
interference, and the rendering is a smooth function of the pose, as a fit requires.
`docs/registration-method.md` has the equations.
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
"""Angles of incidence at which the brightness of the surface is a parameter, log-linear between
them: dense in the specular lobe of a smooth surface."""

PATTERN_HALF_WIDTH_M = 24e-3
"""Half width of the point spread function: five sidelobes of the 94 x 94 imager."""

_BLUR_REACH = 5.0  # standard deviations beyond which a Gaussian, 4e-6 of its middle, is left out
VIEWS = 3
"""Visibility is computed from a square grid of so many by so many viewpoints over the aperture,
without the centre: eight, the group size of the kernel."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredImage:
    """Power and range of the pixels of a depth map.

    `x_m`, `y_m`, evenly spaced pixel centres, `step_m` apart; `power`, shape (n_y, n_x), squared
    amplitude, 1 at the maximum; `range_m`, shape (n_y, n_x), distance of the depth points from the
    centre of the aperture, NaN without depth.
    """

    x_m: np.ndarray
    y_m: np.ndarray
    power: np.ndarray
    range_m: np.ndarray
    step_m: tuple[float, float]

    @classmethod
    def of(cls, depth: DepthMap, step_m: float, centre_m: np.ndarray) -> MeasuredImage:
        """Decimate a depth map to pixels about `step_m` apart."""
        thin = decimated(depth, step_m)
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


def decimated(depth: DepthMap, step_m: float) -> DepthMap:
    """Every k-th pixel of a depth map with evenly spaced pixels, about `step_m` apart."""
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


def knot_weights(angle: np.ndarray) -> np.ndarray:
    """Share of every knot in the log brightness at angles of incidence, (n_knots, n)."""
    return np.array([np.interp(angle, KNOTS_RAD, row) for row in np.eye(len(KNOTS_RAD))])


class Aperture:
    """The radar of a rendering: its centre, viewpoints and point spread function."""

    def __init__(self, array: AntennaArray, centre_frequency_hz: float) -> None:
        antennas_m = np.concatenate([array.tx_m, array.rx_m])
        low, high = antennas_m.min(axis=0), antennas_m.max(axis=0)
        self.array = array
        self._cells_m2: dict[float, float] = {}
        self.centre_m = 0.5 * (low + high)
        self.wavelength_m = SPEED_OF_LIGHT_M_PER_S / centre_frequency_hz
        share = np.linspace(0.0, 1.0, VIEWS)
        grid = np.array([(u, v) for u in share for v in share if (u, v) != (0.5, 0.5)])
        # Slightly inside the extent, so that single outer antennas do not count.
        spread = 0.5 + 0.97 * (grid - 0.5)
        self.viewpoints_m = np.concatenate(
            [low[:2] + spread * (high - low)[:2], np.full((len(grid), 1), self.centre_m[2])], axis=1
        )

    def point_spread(self, range_m: float, step_m: Sequence[float]) -> np.ndarray:
        """Power response to a point at boresight, shape (n_y, n_x), odd, with sum 1.

        At the centre frequency: within the half width the bandwidth changes it little.
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
            cycles = (np.sqrt(there) - np.sqrt(here)) / self.wavelength_m
            response *= np.exp(2j * np.pi * cycles).mean(axis=1)
        power = (np.abs(response) ** 2).reshape(grid_x.shape)
        return power / power.sum()

    def cell_m2(self, range_m: float) -> float:
        """Area of a resolution cell, the correlation area of the speckle.

        The integral of the speckle's squared correlation, which for a uniform aperture equals the
        power pattern (J. W. Goodman, "Speckle Phenomena in Optics", 2007).
        """
        key = round(range_m, 3)
        if key not in self._cells_m2:
            step_m = 1e-3
            pattern = self.point_spread(key, (step_m, step_m))
            self._cells_m2[key] = float(step_m**2 * pattern.sum() / pattern.max())
        return self._cells_m2[key]


class Canvas:
    """Draws surface samples on the pixels of a measured image.

    `blur_m` is the standard deviation of an additional Gaussian blur of both, for a wider basin of
    attraction.
    """

    def __init__(self, measured: MeasuredImage, aperture: Aperture, blur_m: float = 0.0) -> None:
        self.measured, self.aperture = measured, aperture
        self.reference_m = float(np.nanmedian(measured.range_m))
        pattern = aperture.point_spread(self.reference_m, measured.step_m)
        self.power = measured.power
        if blur_m > 0.0:
            pattern = _blurred(pattern, blur_m, measured.step_m)
            blurred = _blurred(self.power, blur_m, measured.step_m)
            reach_y, reach_x = (n - m for n, m in zip(blurred.shape, self.power.shape, strict=True))
            blurred = blurred[reach_y // 2 : -(reach_y // 2), reach_x // 2 : -(reach_x // 2)]
            self.power = np.maximum(blurred, 0.0) / blurred.max()
        self._pattern = pattern
        self._spectra: dict[tuple[int, int], np.ndarray] = {}

    def sight(self, points_m: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Range beyond `reference_m`, metres, and angle of incidence, radians, both (n,)."""
        sight_m = points_m - self.aperture.centre_m
        from_centre_m = np.linalg.norm(sight_m, axis=1)
        cosine = np.abs((normals * sight_m).sum(axis=1)) / from_centre_m
        return from_centre_m - self.reference_m, np.arccos(np.minimum(cosine, 1.0))

    def splat(
        self, points_m: np.ndarray, range_m: np.ndarray, brightness: np.ndarray
    ) -> np.ndarray:
        """Samples as bilinear weights of pixels: power and power times range, (k, 2, n_y, n_x).

        `range_m` as of `sight`; one picture per row of `brightness`, (k, n_samples).
        """
        n_y, n_x = self.measured.power.shape
        inside, corners = self.corners(points_m)
        drawn = np.zeros((len(brightness), 2, n_y, n_x))
        for row, targets in zip(brightness[:, inside], drawn, strict=True):
            for values, target in zip((row, row * range_m[inside]), targets, strict=True):
                for place, share in corners:
                    target += np.bincount(place, values * share, n_y * n_x).reshape(n_y, n_x)
        return drawn

    def corners(
        self, points_m: np.ndarray
    ) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
        """Mask (n,) of the points in the picture; for these four pixels and their bilinear shares.

        Pixels count row by row.
        """
        n_y, n_x = self.measured.power.shape
        step_x, step_y = self.measured.step_m
        u = (points_m[:, 0] - self.measured.x_m[0]) / step_x
        v = (points_m[:, 1] - self.measured.y_m[0]) / step_y
        left, low = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        inside = (left >= 0) & (left < n_x - 1) & (low >= 0) & (low < n_y - 1)
        right_share, high_share = (u - left)[inside], (v - low)[inside]
        pixel = (low * n_x + left)[inside]
        return inside, [
            (pixel, (1 - right_share) * (1 - high_share)),
            (pixel + 1, right_share * (1 - high_share)),
            (pixel + n_x, (1 - right_share) * high_share),
            (pixel + n_x + 1, right_share * high_share),
        ]

    def convolved(self, drawn: np.ndarray) -> np.ndarray:
        """Pictures of `splat`, (..., n_y, n_x), seen through the point spread function.

        Only the part of the pictures that has anything in it takes time.
        """
        seen = np.zeros(drawn.shape, drawn.dtype)
        lit = (drawn != 0.0).any(axis=tuple(range(drawn.ndim - 2)))
        if not lit.any():
            return seen
        part, into, of, padded = [], [], [], []
        for axis, size in enumerate(self._pattern.shape):
            first, last = np.flatnonzero(lit.any(axis=1 - axis))[[0, -1]]
            half = size // 2
            begin, end = max(0, first - half), min(lit.shape[axis], last + half + 1)
            part.append(slice(first, last + 1))
            into.append(slice(begin, end))
            of.append(slice(begin - first + half, end - first + half))
            padded.append(fft.next_fast_len(int(last - first + size), real=True))
        spectrum = fft.rfft2(drawn[..., part[0], part[1]], padded) * self._spectrum(*padded)
        seen[..., into[0], into[1]] = fft.irfft2(spectrum, padded)[..., of[0], of[1]]
        return seen

    def _spectrum(self, n_y: int, n_x: int) -> np.ndarray:
        """That of the point spread function, on so many pixels."""
        if (n_y, n_x) not in self._spectra:
            self._spectra[n_y, n_x] = fft.rfft2(self._pattern, (n_y, n_x))
        return self._spectra[n_y, n_x]

    def mean_range(self, power: np.ndarray, moment: np.ndarray) -> Pixels:
        """Power, and the mean range in metres, of one convolved picture."""
        power = np.maximum(power, 1e-12)
        return power, self.reference_m + moment / power


def _blurred(image: np.ndarray, blur_m: float, step_m: tuple[float, float]) -> np.ndarray:
    """An image with a wider margin of zeros, through a Gaussian of this standard deviation."""
    margin = [int(np.ceil(_BLUR_REACH * blur_m / step)) for step in step_m[::-1]]
    wide = np.pad(image, [(m, m) for m in margin])
    along_y = np.fft.fftfreq(wide.shape[0], step_m[1])[:, None]
    along_x = np.fft.rfftfreq(wide.shape[1], step_m[0])[None, :]
    soft = np.exp(-2.0 * (np.pi * blur_m) ** 2 * (along_x**2 + along_y**2))
    return fft.irfft2(fft.rfft2(wide) * soft, wide.shape)


class MeshRendering(Canvas):
    """Renderings of a mesh, as given, on the pixels of a measured image, in any pose."""

    def __init__(
        self,
        surface: VisibleSurface,
        measured: MeasuredImage,
        aperture: Aperture,
        blur_m: float = 0.0,
    ) -> None:
        super().__init__(measured, aperture, blur_m)
        self.surface = surface
        self._visible: np.ndarray = np.zeros(0, dtype=np.intp)
        self._share: np.ndarray = np.zeros(0)

    def update_visibility(self, transform: np.ndarray, every: slice = slice(None)) -> None:
        """Compute which samples are visible when the mesh is moved by `transform`, shape (4, 4).

        `every` decimates the samples: its two halves are independent.
        """
        viewpoints_m = moved(np.linalg.inv(transform), self.aperture.viewpoints_m)
        share = self.surface.visible_from(viewpoints_m).mean(axis=1)
        self._visible = np.flatnonzero(share > 0)[every]
        self._share = share[self._visible]

    @property
    def n_visible(self) -> int:
        return len(self._visible)

    def visible_points_m(self, transform: np.ndarray) -> np.ndarray:
        """The visible samples after `transform`, shape (n, 3), metres."""
        return moved(transform, self.surface.points_m[self._visible])

    def render(self, transform: np.ndarray, log_brightness: np.ndarray) -> Pixels:
        """Power and mean range, metres, of every pixel, both (n_y, n_x), of the moved mesh.

        `transform` is near that of the last `update_visibility`. `log_brightness`, (n_knots,), is
        the natural logarithm of the power per area at `KNOTS_RAD`.
        """
        points_m, range_m, angle = self._geometry(transform)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        return self.mean_range(*self.convolved(self.splat(points_m, range_m, bright[None])[0]))

    def brightness_derivatives(
        self, transform: np.ndarray, log_brightness: np.ndarray
    ) -> list[Pixels]:
        """Derivatives of power and of power x range by each knot's logarithm."""
        points_m, range_m, angle = self._geometry(transform)
        bright = self._share * np.exp(np.interp(angle, KNOTS_RAD, log_brightness))
        drawn = self.splat(points_m, range_m, bright * knot_weights(angle))
        return [(power, moment) for power, moment in self.convolved(drawn)]

    def _geometry(self, transform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        points_m = self.visible_points_m(transform)
        normals = self.surface.normals[self._visible] @ transform[:3, :3].T
        return points_m, *self.sight(points_m, normals)
