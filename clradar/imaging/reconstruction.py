"""Model-based images: the reflectivity that explains a capture, full or sparse (E14)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clradar.errors import MissingPackage
from clradar.imaging.grid_check import warn_of_grid
from clradar.imaging.operator import ImagingOperator
from clradar.model import Capture, Volume, VoxelGrid, checks
from clradar.model.progress import Progress
from clradar.opencl import Device, open_device

METHODS = ("least-squares", "sparse")
ITERATIONS = {"least-squares": 30, "sparse": 100}  # at most, unless the caller says otherwise
SPARSITY_DB = -30.0  # twice the dynamic range that pictures show
CHANGE = 2e-3
"""Of the reflectivity from one iteration to the next, relative, at which it has settled."""

POWER_STEPS = 8
NORM_MARGIN = 1.1
"""Applications of the operator pair that find its largest singular value, and what the square that
they find, which is from below, is multiplied with: a step that is too long diverges, and the
iterations start again with half of it."""


@dataclass(slots=True)
class _Fit:
    """A reflectivity on its way, raveled, and how well it explains the samples."""

    reflectivity: np.ndarray
    residual: float
    explained: bool = False


def reconstruct(
    capture: Capture,
    grid: VoxelGrid,
    *,
    method: str = "least-squares",
    damping_db: float | None = None,
    sparsity_db: float | None = None,
    iterations: int | None = None,
    tolerance_db: float | None = None,
    check_grid: bool = True,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Volume:
    """Find the reflectivity of the voxels that explains a capture, by iteration; it needs PyLops.

    With A the `ImagingOperator`, s the samples and N their number, "least-squares" looks for the
    minimum of ``|A rho - s|^2 + d N |rho|^2`` and "sparse" for that of
    ``|A rho - s|^2 / 2 + m sum |rho|``. What each brings: docs/model-based-imaging.md.

    Parameters
    ----------
    capture : Capture
    grid : VoxelGrid
        All that reflects has to lie in it; two to four voxels per resolution cell.
    method : "least-squares" or "sparse"
        By conjugate gradients (CGLS), or fast iterative shrinkage (FISTA).
    damping_db : float, optional
        For "least-squares": d in decibel. None: no damping, since stopping early regularises.
    sparsity_db : float, optional
        For "sparse": m relative to the largest ``|A^H s|``, below 0; default -30.
    iterations : int, optional
        At most; default 30 for "least-squares", 100 for "sparse".
    tolerance_db : float, optional
        Of the operator.
    check_grid, device, progress
        As of `clradar.backproject`; progress counts iterations.

    Returns
    -------
    Volume
        complex64, on a relative scale. `meta` has `iterations`, the `residual_db` ``|A rho - s| /
        |s|`` that is left, and why it `stopped`: "noise", where least squares leave no more than
        white noise; "change", of less than 0.2 % per iteration; or "iterations".

    Examples
    --------
    Two points 0.7 widths at -3 dB apart, with phases 90 degrees apart.

    >>> array = clradar.arrays.qar50().part(slice(None, None, 6), slice(None, None, 6))
    >>> waveform = clradar.Waveform.sfcw(72e9, 82e9, 8)
    >>> points_m = [[-0.0013, 0, 0.3], [0.0013, 0, 0.3]]
    >>> capture = clradar.forward(points_m, [1, 1j], array, waveform)
    >>> grid = clradar.VoxelGrid.from_extent((-0.01, 0.01), (0, 0), (0.3, 0.3), 5e-4)
    >>> sharp = clradar.reconstruct(capture, grid, method="sparse", check_grid=False)
    >>> amplitude = sharp.max_projection()[0]  # at one point, between them, at the other
    >>> print((amplitude[17:24:3] / amplitude.max()).round(1))
    [1.  0.1 1. ]
    """
    checks.instance("reconstruct: capture", capture, Capture)
    checks.instance("reconstruct: grid", grid, VoxelGrid)
    method, weight, most = _checked(method, damping_db, sparsity_db, iterations)
    _require_pylops()
    opened = open_device(device)
    operator = ImagingOperator(
        capture.array, capture.waveform, grid, tolerance_db=tolerance_db, device=opened
    )
    image = operator.adjoint(capture)
    if check_grid:
        weights = np.ones(capture.waveform.n_freq)
        warn_of_grid(capture, grid, image / np.float32(capture.data.size), weights, opened)
    samples = capture.data.ravel()
    size = float(np.linalg.norm(samples))
    fit, done, stopped = _Fit(np.zeros(image.size, np.complex64), size), 0, "change"
    if image.any():
        solve = _least_squares if method == "least-squares" else _sparse
        steps = solve(operator.as_linear_operator(), samples, image.ravel(), weight, most)
        stopped = "iterations"
        for done in range(1, most + 1):
            before, fit = fit, next(steps)
            if progress is not None:
                progress(done, most)
            change = np.linalg.norm(fit.reflectivity - before.reflectivity)
            if fit.explained or change <= CHANGE * np.linalg.norm(fit.reflectivity):
                stopped = "noise" if fit.explained else "change"
                break
    level_db = SPARSITY_DB if sparsity_db is None else sparsity_db
    meta = {
        "kind": "image",
        "method": method,
        **({"sparsity_db": level_db} if method == "sparse" else {"damping_db": damping_db}),
        "tolerance_db": operator.tolerance_db,
        "iterations": done,
        "stopped": stopped,
        "residual_db": float(20 * np.log10(fit.residual / size)) if image.any() else None,
        "device": dict(opened.describe()),
        "capture": dict(capture.meta),
    }
    return Volume(fit.reflectivity.reshape(grid.shape), grid, meta)


def _least_squares(
    linear: Any, samples: np.ndarray, image: np.ndarray, damping: float, most: int
) -> Iterator[_Fit]:
    """Yield the iterates of conjugate gradients on the normal equations."""
    from pylops.optimization.cls_basic import CGLS

    solver = CGLS(linear)
    # PyLops squares what it is given.
    x = solver.setup(y=samples, x0=None, niter=most, damp=np.sqrt(damping * samples.size))
    while True:
        x = solver.step(x)
        residual = float(np.linalg.norm(solver.s))
        # Of the normal equations; without damping the residual's image.
        gradient = float(np.sqrt(solver.kold))
        yield _Fit(x, residual, gradient <= residual * np.sqrt(image.size))


def _sparse(
    linear: Any, samples: np.ndarray, image: np.ndarray, threshold: float, most: int
) -> Iterator[_Fit]:
    """Yield the iterates of accelerated shrinkage."""
    from pylops.optimization.cls_sparsity import FISTA

    square = NORM_MARGIN * _largest_eigenvalue(linear)
    weight = threshold * float(np.abs(image).max())
    empty = float(np.linalg.norm(samples)) ** 2 / 2
    solver = FISTA(linear)
    while True:
        x = solver.setup(
            y=samples, x0=np.zeros(image.size, np.complex64), niter=most,
            eps=2 * weight, alpha=1 / square, tol=0.0,
        )  # fmt: skip
        z, converging = x.copy(), True
        while converging:
            x, z, _ = solver.step(x, z)
            # PyLops keeps |r|^2 / 2 + eps sum |x|.
            data = solver.cost[-1] - solver.eps * float(np.abs(x).sum(dtype=np.float64))
            converging = data <= 2 * empty
            if converging:
                yield _Fit(x, float(np.sqrt(max(2 * data, 0.0))))
        square *= 2  # the eigenvalue was too small for these steps


def _largest_eigenvalue(linear: Any) -> float:
    """Estimate that of A^H A from below, by powers of it on an image of noise."""
    random = np.random.default_rng(0)
    noise = random.standard_normal((2, linear.shape[0]), dtype=np.float32)
    vector, square = linear.rmatvec((noise[0] + 1j * noise[1]).astype(np.complex64)), 0.0
    for _ in range(POWER_STEPS):
        vector = linear.rmatvec(linear.matvec(vector / np.linalg.norm(vector)))
        square = float(np.linalg.norm(vector))
    return square


def _checked(
    method: str, damping_db: float | None, sparsity_db: float | None, iterations: int | None
) -> tuple[str, float, int]:
    """Return method, weight of its penalty, and the most iterations."""
    checks.one_of("reconstruct: method", method, METHODS)
    given = {"damping_db": damping_db, "sparsity_db": sparsity_db}
    own = "damping_db" if method == "least-squares" else "sparsity_db"
    for name, value in given.items():
        if value is not None and name != own:
            checks.fail(f"reconstruct: {name}", f"none with method={method!r}", value)
    most = ITERATIONS[method] if iterations is None else iterations
    most = checks.whole("reconstruct: iterations", most, 1, 100_000)
    if method == "least-squares":
        if damping_db is None:
            return method, 0.0, most
        level_db = checks.real("reconstruct: damping_db", damping_db)
        if abs(level_db) > checks.MAX_DYNAMIC_RANGE_DB:
            checks.fail("reconstruct: damping_db", "within 1000 dB of 0", level_db)
        return method, 10 ** (level_db / 10), most
    level_db = checks.real(
        "reconstruct: sparsity_db", SPARSITY_DB if sparsity_db is None else sparsity_db
    )
    if not -checks.MAX_DYNAMIC_RANGE_DB <= level_db < 0:
        checks.fail("reconstruct: sparsity_db", "below 0 dB, at least -1000", level_db)
    return method, 10 ** (level_db / 20), most


def _require_pylops() -> None:
    try:
        import pylops  # noqa: F401
    except ImportError as error:
        raise MissingPackage(
            "reconstruct: expected the package pylops, found none; pip install pylops"
        ) from error
