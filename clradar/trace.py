"""Host side of the ray tracer: samples on the surface, visibility, bounces, receptions.

The model and its equations are in ``docs/equations.md``, the kernels in ``sample.cl``,
``visibility.cl`` and ``trace.cl``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from clradar.bundles import GROUP, bundled, items
from clradar.bvh import build_bvh, error_bound_m, face_normals, flatten
from clradar.errors import MeshError
from clradar.model import AntennaArray, Paths, Scene, TraceStatistics, checks
from clradar.normals import CREASE_DEG, corner_normals
from clradar.opencl import Buffers, Device, build, open_device
from clradar.packing import hi_lo

RECEPTION_RADIUS_M = 0.010
SAMPLES_PER_MM2 = 10.0
RAYS_PER_SAMPLE = 4

EXPECTED_SAMPLES_PER_MM2 = 1.0
"""For ``estimator="expected"``, which needs fewer; each then stands for as many more rays."""

TILE_SAMPLES = 16384
"""Samples per tile, fewer where memory is short. No result depends on it."""

RECEPTION_BYTES = 8 + 16
"""Device memory per reception: key and path."""

Lit = TypeVar("Lit", bound="LitSurface")

Progress = Callable[[int, int], None]
"""Called with (done, total) samples."""


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """How rays are launched, bounced and received; the arguments of `simulate`, resolved.

    Exactly one of `samples_per_mm2` and `rays_per_face` is not None.
    """

    samples_per_mm2: float | None
    rays_per_face: int | None
    rays_per_sample: int
    reception_radius_m: float
    max_bounces: int
    normals: str
    crease_deg: float
    amplitude: str
    pattern_exponent: float
    seed: int
    estimator: str = "stochastic"


@dataclass(frozen=True, slots=True)
class _SampleOptions:
    width: int


@dataclass(frozen=True, slots=True)
class _VisibilityOptions:
    width: int
    stack: int


@dataclass(frozen=True, slots=True)
class _TraceOptions:
    width: int
    stack: int
    spreading: bool


@dataclass(frozen=True, slots=True, eq=False)
class Receptions:
    """Receptions of one tile, sorted by pair, then sample, ray and bounce.

    Attributes
    ----------
    pair : ndarray, shape (n,), uint32
    path : ndarray, shape (n, 4), float32
        Length as hi + lo, metres; amplitude; unused.
    bounces : ndarray, shape (n,), uint8
    face : ndarray, shape (n,), int32
        Where the path was reflected first.
    statistics : TraceStatistics
    """

    pair: np.ndarray
    path: np.ndarray
    bounces: np.ndarray
    face: np.ndarray
    statistics: TraceStatistics


def resolve_settings(
    *,
    samples_per_mm2: float | None = None,
    rays_per_face: int | None = None,
    rays_per_sample: int | None = None,
    reception_radius_m: float = RECEPTION_RADIUS_M,
    max_bounces: int = 1,
    normals: str = "smooth",
    crease_deg: float = CREASE_DEG,
    amplitude: str = "unit",
    pattern_exponent: float = 0.0,
    seed: int = 0,
    estimator: str = "stochastic",
) -> TraceSettings:
    """Check the arguments of `trace` and `simulate` and fill in what depends on others."""
    if samples_per_mm2 is not None and rays_per_face is not None:
        checks.fail(
            "samples_per_mm2, rays_per_face",
            "one of the two",
            f"both ({samples_per_mm2}, {rays_per_face})",
        )
    estimator = checks.one_of("estimator", estimator, ("stochastic", "expected"))
    if rays_per_sample is None:
        rays_per_sample = RAYS_PER_SAMPLE if rays_per_face is None else 1
    rays_per_sample = checks.whole("rays_per_sample", rays_per_sample, 1, 2**16)
    if rays_per_face is not None:
        rays_per_face = checks.whole("rays_per_face", rays_per_face, 1, 2**20)
    elif samples_per_mm2 is None and estimator == "expected":
        # Fewer samples, of which each stands for more rays: the sum keeps its mean.
        samples_per_mm2 = EXPECTED_SAMPLES_PER_MM2
        rays_per_sample *= round(SAMPLES_PER_MM2 / EXPECTED_SAMPLES_PER_MM2)
    else:
        density = SAMPLES_PER_MM2 if samples_per_mm2 is None else samples_per_mm2
        samples_per_mm2 = checks.positive("samples_per_mm2", density)
    exponent = checks.real("pattern_exponent", pattern_exponent)
    if exponent < 0 or (exponent > 0 and amplitude != "spreading"):
        checks.fail(
            "pattern_exponent", "0, or a positive number with amplitude='spreading'", exponent
        )
    crease = checks.real("crease_deg", crease_deg)
    max_bounces = checks.whole("max_bounces", max_bounces, 1, 255)
    if estimator == "expected" and max_bounces > 1:
        checks.fail("max_bounces", "1 with estimator='expected'", max_bounces)
    return TraceSettings(
        samples_per_mm2=samples_per_mm2,
        rays_per_face=rays_per_face,
        rays_per_sample=rays_per_sample,
        reception_radius_m=checks.positive("reception_radius_m", reception_radius_m),
        max_bounces=max_bounces,
        normals=checks.one_of("normals", normals, ("smooth", "face")),
        crease_deg=crease,
        amplitude=checks.one_of("amplitude", amplitude, ("unit", "spreading")),
        pattern_exponent=exponent,
        seed=checks.whole("seed", seed, 0, 2**64 - 1),
        estimator=estimator,
    )


def trace(
    scene: Scene,
    array: AntennaArray,
    *,
    samples_per_mm2: float | None = None,
    rays_per_face: int | None = None,
    rays_per_sample: int | None = None,
    reception_radius_m: float = RECEPTION_RADIUS_M,
    max_bounces: int = 1,
    normals: str = "smooth",
    crease_deg: float = CREASE_DEG,
    amplitude: str = "unit",
    pattern_exponent: float = 0.0,
    seed: int = 0,
    device: Device | str | None = None,
    progress: Progress | None = None,
) -> Paths:
    """Trace rays from every Tx over the scene to every Rx (Braeunig et al., EuRAD 2023).

    Parameters
    ----------
    scene : Scene
    array : AntennaArray
    samples_per_mm2 : float, 1/mm^2
        Density of surface samples, whatever the tessellation; 10 unless `rays_per_face` is given.
    rays_per_face : int
        As in the paper: this many samples on every face, instead of a density.
    rays_per_sample : int
        Outgoing rays per sample and Tx; 4 with `samples_per_mm2`, 1 with `rays_per_face`.
    reception_radius_m : float, metres
        A ray is received by every Rx whose sphere of this radius it enters before it hits anything.
    max_bounces : int, 1 to 255
    normals : "smooth" or "face"
    crease_deg : float, degrees
        Edges sharper than this stay sharp in "smooth".
    amplitude : "unit" or "spreading"
        1 per path as in the paper, or 1 / (R1 R2): R1 the length up to the last reflection, R2 the
        last leg, metres.
    pattern_exponent : float
        With "spreading": both antennas have the field pattern cos(angle to +z)^exponent.
    seed : int, 0 to 2^64 - 1
    device : Device, str or None
        See `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) samples.

    Returns
    -------
    Paths
        Sorted by pair, then sample, ray and bounce; the same bits for the same seed and device.

    Raises
    ------
    ModelError
        An argument that cannot be meant.
    MeshError
        The scene has no face with area, or more samples than 2^31.
    DeviceError
        The device is missing, out of memory or fails.
    """
    checks.instance("trace: scene", scene, Scene)
    checks.instance("trace: array", array, AntennaArray)
    settings = resolve_settings(
        samples_per_mm2=samples_per_mm2,
        rays_per_face=rays_per_face,
        rays_per_sample=rays_per_sample,
        reception_radius_m=reception_radius_m,
        max_bounces=max_bounces,
        normals=normals,
        crease_deg=crease_deg,
        amplitude=amplitude,
        pattern_exponent=pattern_exponent,
        seed=seed,
    )
    with Tracer(scene, array, settings, open_device(device)) as tracer:
        tiles = list(tracer.tiles(progress))
    return _paths_of(tiles, array)


def _paths_of(tiles: list[Receptions], array: AntennaArray) -> Paths:
    pair = np.concatenate([tile.pair for tile in tiles])
    # Tiles come in the order of samples and each is sorted, so a stable sort by pair is enough.
    place = np.argsort(pair, kind="stable")
    pair = pair[place].astype(np.int64)
    path = np.concatenate([tile.path for tile in tiles])[place]
    bounces = np.concatenate([tile.bounces for tile in tiles])[place]
    statistics = tiles[0].statistics
    for tile in tiles[1:]:
        statistics = statistics + tile.statistics
    columns = {
        "tx": (pair // array.n_rx).astype(np.int32),
        "rx": (pair % array.n_rx).astype(np.int32),
        "length_m": path[:, 0].astype(np.float64) + path[:, 1],
        "amplitude": np.ascontiguousarray(path[:, 2]),
        "bounces": bounces,
    }
    for column in columns.values():
        column.flags.writeable = False  # so that the record need not copy it
    return Paths(**columns, n_tx=array.n_tx, n_rx=array.n_rx, statistics=statistics)


def samples_per_face(scene: Scene, settings: TraceSettings) -> np.ndarray:
    """Return how many samples each face gets, shape (n_faces,), int64.

    By density: face f gets the whole numbers between the running areas before and after it, so that
    the total is right to one sample whatever the tessellation. Faces without area get none.
    """
    area_mm2 = face_normals(scene.triangles_m)[1] * 1e6
    if not (area_mm2 > 0).any():
        raise MeshError("scene: expected at least one face with an area, got only degenerate faces")
    if settings.rays_per_face is not None:
        return np.where(area_mm2 > 0, settings.rays_per_face, 0).astype(np.int64)
    assert settings.samples_per_mm2 is not None
    # The offset of one half keeps a scene smaller than one sample from getting none at random.
    running = np.floor(np.cumsum(area_mm2) * settings.samples_per_mm2 + 0.5)
    counts = np.diff(running, prepend=0.0).astype(np.int64)
    if counts.sum() == 0:
        counts[int(area_mm2.argmax())] = 1
    return counts


class LitSurface:
    """A scene and an array on a device: samples of the surface, and which Tx see them.

    A context manager: its device memory is freed when the block ends. What follows from the samples
    is up to those that inherit.
    """

    def __init__(
        self, scene: Scene, array: AntennaArray, settings: TraceSettings, device: Device
    ) -> None:
        self.array, self.settings, self.device = array, settings, device
        counts = samples_per_face(scene, settings)
        self.n_samples = int(counts.sum())
        if self.n_samples >= 2**31:
            raise MeshError(
                f"scene: expected fewer than 2^31 samples, got {self.n_samples}; lower "
                f"samples_per_mm2 or rays_per_face, or check the unit of the mesh"
            )
        if array.n_tx * array.n_rx >= 2**32:
            checks.fail("array", "fewer than 2^32 pairs", f"{array.n_tx} x {array.n_rx}")
        self._scene = scene
        self._face_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
        self._buffers = Buffers(device)
        self._tile_samples = 0
        self._tile: list[Any] = []

    def __enter__(self: Lit) -> Lit:
        try:
            self._prepare()
        except BaseException:
            self._buffers.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        self._buffers.__exit__(None, None, None)

    def _prepare(self) -> None:
        scene, array, device, up = self._scene, self.array, self.device, self._buffers.upload
        triangles = scene.triangles_m
        bvh = build_bvh(triangles, device)
        self._delta = np.float32(error_bound_m(triangles, array.tx_m, array.rx_m))
        nodes, records, stack = flatten(bvh, triangles, float(self._delta))
        corners, faces = corner_normals(scene, self.settings.normals, self.settings.crease_deg)
        alpha = np.asarray(scene.alpha, dtype=np.float32)
        self._sampling = [
            up(self._face_start),
            up(triangles.astype(np.float32)),
            up(corners.astype(np.float32)),
            up(faces.astype(np.float32)),
        ]
        self._tree = [up(nodes), up(records)]
        self._face_alpha = alpha
        self._n_tx_groups = -(-array.n_tx // GROUP)
        self._n_rx_groups = -(-array.n_rx // GROUP)
        self._tx_soa = up(bundled(array.tx_m))
        out_of_reach = array.rx_m.max(axis=0) + 1e3 + self.settings.reception_radius_m * 10
        self._rx_soa = up(bundled(array.rx_m, out_of_reach))
        self._sample = build(device, "sample.cl", _SampleOptions(1))
        self._visibility = build(device, "visibility.cl", _VisibilityOptions(device.width, stack))
        self._prepare_rays(stack)
        self._size_tiles()

    def _prepare_rays(self, stack: int) -> None:
        """Upload and build what comes after the samples; `stack` is what a traversal needs."""
        raise NotImplementedError

    def _size_tiles(self) -> None:
        """Set `_tile_samples` and `_tile`, and take what memory is needed per tile."""
        raise NotImplementedError

    def _sample_buffers(self, count: int) -> list[Any]:
        """Buffers for points, shading and face normals, faces, alpha and visible Tx."""
        lengths = (12, 12, 12, 4, 4, self._n_tx_groups)
        return [self._buffers.empty(length * count) for length in lengths]

    def _see(self, first: int, count: int) -> tuple[np.ndarray, int]:
        """Make the samples and ask which Tx see them; return their faces, and how many do."""
        u = np.uint32
        points, shading, geometric, face, _, visible = self._tile
        self._sample.launch(
            "sample_surface", (count,), u(len(self._face_start) - 1), u(first), u(count),
            *self._seed_words(), *self._sampling, points, shading, geometric, face,
        )  # fmt: skip
        self._visibility.launch(
            "visible_antennas", items(self.device, count, self._n_tx_groups), u(count),
            u(self.array.n_tx), u(self._n_tx_groups), self._delta, *self._tree, self._tx_soa,
            points, geometric, visible,
        )  # fmt: skip
        bits = self._buffers.read(visible, count * self._n_tx_groups, np.uint8)
        return self._buffers.read(face, count, np.int32), int(np.unpackbits(bits).sum())

    def _seed_words(self) -> tuple[np.uint32, np.uint32]:
        seed = self.settings.seed
        return np.uint32(seed & 0xFFFFFFFF), np.uint32(seed >> 32)


class Tracer(LitSurface):
    """A scene and an array on a device, ready to be traced tile by tile."""

    def _prepare_rays(self, stack: int) -> None:
        array, up = self.array, self._buffers.upload
        self._surface = [self._sampling[2], up(self._face_alpha)]
        self._antennas = [up(part) for a in (array.tx_m, array.rx_m) for part in hi_lo(a)]
        self._box = self._reception_box()
        self._counter = self._buffers.zeros(12)
        spreading = self.settings.amplitude == "spreading"
        self._trace = build(self.device, "trace.cl", _TraceOptions(1, stack, spreading))

    def _size_tiles(self) -> None:
        """Share what memory is left between samples and receptions."""
        per_sample = 3 * 12 + 4 + 4 + self._n_tx_groups
        free = min(self._buffers.free_bytes, 8 * self.device.max_buffer_bytes)
        # Neither a ray's ordinal nor the count of receptions in a tile may exceed 32 bits.
        rays = self.settings.rays_per_sample * self.settings.max_bounces
        most = max(1, (2**32 - 1) // (rays * self.array.n_tx * self.array.n_rx))
        wanted = min(TILE_SAMPLES, self.n_samples, most, max(1, free // 4 // per_sample))
        self._tile_samples = int(wanted)
        self._tile = self._sample_buffers(self._tile_samples)
        self._keys = self._paths = None
        self._capacity = 0
        self._grow(max(1, min(64 * wanted, self._most_receptions())))

    def _most_receptions(self) -> int:
        """How many receptions fit the memory that is left, counting what they hold already."""
        held = self._capacity * RECEPTION_BYTES
        room = (self._buffers.free_bytes + held) // RECEPTION_BYTES
        return int(min(room, self.device.max_buffer_bytes // 16, 2**32 - 1))

    def _grow(self, capacity: int) -> None:
        for buffer in (self._keys, self._paths):
            if buffer is not None:
                self._buffers.release(buffer)
        self._keys = self._paths = None
        self._capacity = 0
        self._keys = self._buffers.empty(8 * capacity)
        self._paths = self._buffers.empty(16 * capacity)
        self._capacity = capacity

    def tiles(self, progress: Progress | None = None) -> Iterator[Receptions]:
        """Yield the receptions of all samples, tile by tile, in the order of samples."""
        for _, tile in self.tiles_of([self._face_alpha], progress):
            yield tile

    def tiles_of(
        self, alphas: Sequence[np.ndarray], progress: Progress | None = None
    ) -> Iterator[tuple[int, Receptions]]:
        """Yield what `tiles` would for several alphas: which of them, and its receptions.

        Samples and which Tx they see are found once for all. Each of `alphas` has shape (n_faces,),
        float32; the receptions of each come in the order of samples.
        """
        first = 0
        while first < self.n_samples:
            count = min(self._tile_samples, self.n_samples - first)
            yield from self._tile_of(first, count, list(enumerate(alphas)))
            first += count
            if progress is not None:
                progress(first, self.n_samples)

    def _tile_of(
        self, first: int, count: int, alphas: list[tuple[int, np.ndarray]]
    ) -> Iterator[tuple[int, Receptions]]:
        faces, seen = self._see(first, count)
        for at, (index, alpha) in enumerate(alphas):
            received, outgoing, absorbed = self._send(first, count, faces, alpha)
            if received > self._capacity:
                if received > self._most_receptions() and count > 1:
                    half = self._tile_samples = count // 2
                    yield from self._tile_of(first, half, alphas[at:])
                    yield from self._tile_of(first + half, count - half, alphas[at:])
                    return
                self._grow(received)  # raises where one sample alone does not fit
                received, outgoing, absorbed = self._send(first, count, faces, alpha)
            statistics = TraceStatistics(count, seen, outgoing, absorbed)
            yield index, self._collect(received, faces, statistics)

    def _send(
        self, first: int, count: int, faces: np.ndarray, face_alpha: np.ndarray
    ) -> tuple[int, int, int]:
        """Trace the rays of what `_see` made; return receptions, outgoing and absorbed draws."""
        s, array = self.settings, self.array
        u = np.uint32
        points, shading, geometric, _, alpha, visible = self._tile
        self._buffers.write(alpha, face_alpha[faces])
        self._buffers.write(self._surface[1], face_alpha)
        self._buffers.write(self._counter, np.zeros(3, np.uint32))
        self._trace.launch(
            "trace_rays", (count, self._n_tx_groups), u(count), u(array.n_tx), u(array.n_rx),
            u(self._n_tx_groups), u(self._n_rx_groups), u(s.rays_per_sample), u(s.max_bounces),
            u(first), *self._seed_words(), np.float32(s.reception_radius_m),
            np.float32(s.pattern_exponent), self._delta, *self._box, u(self._capacity),
            *self._tree, *self._surface, *self._antennas, self._rx_soa, points, shading, geometric,
            alpha, visible, self._counter, self._keys, self._paths,
        )  # fmt: skip
        received, outgoing, absorbed = self._buffers.read(self._counter, 3, np.uint32)
        return int(received), int(outgoing), int(absorbed)

    def _reception_box(self) -> list[np.ndarray]:
        """Box around all receivers' spheres as two float4, a little larger for the rounding."""
        pad = self.settings.reception_radius_m * (1 + 1e-5) + float(self._delta)
        corners = []
        for corner in (self.array.rx_m.min(axis=0) - pad, self.array.rx_m.max(axis=0) + pad):
            corners.append(np.append(corner, 0.0).astype(np.float32))
        return corners

    def _collect(self, found: int, faces: np.ndarray, statistics: TraceStatistics) -> Receptions:
        keys = self._buffers.read(self._keys, found, np.uint64)
        paths = self._buffers.read(self._paths, (found, 4), np.float32)
        place = np.argsort(keys)  # keys are unique, so any sort gives the same order
        keys = keys[place]
        within = keys & 0xFFFFFFFF
        most = self.settings.max_bounces
        return Receptions(
            pair=(keys >> 32).astype(np.uint32),
            path=np.take(paths, place, axis=0),
            bounces=(within % most + 1).astype(np.uint8),
            face=faces[within // (self.settings.rays_per_sample * most)],
            statistics=statistics,
        )
