"""Digests of results, to detect any change of a result.

    python tests/results_digests.py --write FILE.json     compute results, write their digests

Results come from the public interface alone. Of each a digest is kept, SHA-256 of type, shape and
bytes, and a fingerprint: a few numbers by which the same result of another machine is recognised.
Digests are compared where `environment` is the same, fingerprints elsewhere.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
import platform
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from importlib import metadata
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import calibration
import clradar
import clradar.dataset
import clradar.hand
from calibration.clutter import gate
from clradar.compare.metrics import METRICS

sys.path.append(str(Path(__file__).with_name("support")))  # where this is run as a program

from dataset_plans import plan_of
from rig_files import RigMaker
from shapes import plate

EXACT = 1e-9
"""Numbers that the host computes in float64 without a decision that rounding could turn. Another
mathematics library rounds each function differently by 1 in 2^53 = 1e-16; the longest phase is
2 pi 82 GHz * 2 m / c = 3400 radians, so 4e-13 of it, and sums and solutions lose three more digits.
Float32 results of such numbers have a tolerance of their own."""

STORED = 1e-6
"""Such numbers that are stored in float32: one rounding is 2^-24 = 6e-8 of each element, and so of
the whole at most. A matrix product in float32 may add some."""

SUMMED = 1e-4
"""Sums of float32 phasors on a device. A phase is exact to 1e-6 rad and a sum of n terms loses
2^-24 sqrt(n), 3e-5 for 2^18 terms, if fused multiply-adds and the order of lanes differ. The range
and the tree method interpolate with constants from the host, so their own errors are the same."""

TRACED = 5e-2
"""What rays make. Kernels fuse products and sums only where marked, so that processors differ
there and in the last digits of roots, exponentials and powers. That moves where a ray ends by about
1e-6 of 0.3 m, and of the rays that end within 10 mm of a receiver a share of 2 * 3e-7 / 0.01 = 6e-5
crosses its sphere's edge; the same goes for edges of faces, and for samples that go to the next
face. Paths that come or go add up at random: sqrt(6e-5) = 0.8 % of the whole if all are alike, more
where few paths make much of it. With every root, exponential and power off by one to four units in
the last place 2.4 % was measured; other random numbers change all of it."""

POINTS = 2e-3
"""Sums over points of surfaces, which rays find to be seen or hidden: of thousands one at the edge
of a shadow may change sides, 1e-3 of the whole or less. A sum by itself is exact to `SUMMED`."""

FOUND = 1e-1
"""What a search finds in the images of traced rays: it follows them, and ends by a step's size.
3.4 % was measured in the same trial, of a shift of 1 cm."""

SUMS = 4
"""Weighted sums in a fingerprint."""


@dataclass(frozen=True, slots=True)
class Result:
    """One result, and what another machine may change of it, relative to the norm of the whole."""

    content: np.ndarray
    tolerance: float

    def record(self) -> dict[str, Any]:
        """As JSON: the digest is that of type, shape and bytes."""
        array = np.ascontiguousarray(self.content)
        header = f"{array.dtype.str} {self.content.shape} ".encode()
        return {
            "sha256": hashlib.sha256(header + array.tobytes()).hexdigest(),
            "tolerance": self.tolerance,
            "fingerprint": fingerprint(self.content),
        }


def fingerprint(array: np.ndarray) -> dict[str, Any]:
    """Return numbers that change little if the array does, and a lot if it is another.

    Shape, how many are NaN, the norm and the largest absolute value of the others, and sums with
    weights that are uniform in +-1; of complex numbers, of the real and the imaginary parts.
    """
    values = np.asarray(array)
    if np.iscomplexobj(values):
        values = np.stack([values.real, values.imag])
    flat = values.astype(np.float64).ravel()
    is_nan = np.isnan(flat)
    flat = np.where(is_nan, 0.0, flat)
    sums = [(weights(flat.size, k) * flat).sum() for k in range(SUMS)]
    return {
        "shape": list(np.shape(array)),
        "nan": int(is_nan.sum()),
        "norm": _short(np.sqrt((flat**2).sum())),
        "largest": _short(np.abs(flat).max(initial=0.0)),
        "sums": [_short(value) for value in sums],
    }


def _short(value: float) -> float:
    """Return a number with ten digits, a tenth of the smallest tolerance."""
    return float(f"{value:.10g}")


def weights(count: int, seed: int) -> np.ndarray:
    """Return the weights of one sum; a bit generator's stream never changes (NEP 19)."""
    return np.random.PCG64(seed).random_raw(count) * 2.0**-63 - 1.0


def unlike(expected: Mapping[str, Any], found: Mapping[str, Any], tolerance: float) -> str:
    """Return by what two fingerprints differ, or nothing.

    If the difference d of two arrays a has at most `tolerance` of the norm, so has the change of
    the largest value, and that of a sum with independent weights w is |w . d|, which is
    sqrt(1/3) |d| by root mean square: with a factor of 3, five deviations. The norm changes by
    a . d / |a| + |d|^2 / 2 |a|: where d is chance that is |d| (tolerance / 2 + 5 / sqrt(n)), five
    deviations, of which n counts an eighth of the numbers, since neighbours are alike. So a gain of
    a few percent is no chance.
    """
    if expected["shape"] != found["shape"]:
        return f"shape {expected['shape']}, now {found['shape']}"
    count = int(np.prod(expected["shape"]))
    if abs(expected["nan"] - found["nan"]) > tolerance * count:
        return f"{expected['nan']} of {count} values NaN, now {found['nan']}"
    scale = tolerance * max(expected["norm"], found["norm"])
    by_chance = min(1.0, tolerance / 2 + 5 / np.sqrt(max(1.0, count / 8)))
    for name, share in (("norm", by_chance), ("largest", 1.0)):
        if abs(expected[name] - found[name]) > share * scale:
            return f"{name} {expected[name]:.9g}, now {found[name]:.9g}"
    for k, (a, b) in enumerate(zip(expected["sums"], found["sums"], strict=True)):
        if abs(a - b) > 3 * scale:
            return f"weighted sum {k} {a:.9g}, now {b:.9g}, of a norm of {expected['norm']:.9g}"
    return ""


def environment(device: clradar.Device) -> dict[str, Any]:
    """Return what the bits depend on besides this package."""
    packages = (
        *("numpy", "scipy", "pyopencl", "pocl-binary-distribution", "trimesh", "scikit-image"),
        *("h5py", "pillow", "pygltflib"),
    )
    return {
        "device": dict(device.describe()),
        "processor": _processor(),
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "packages": {name: metadata.version(name) for name in packages},
    }


def _processor() -> str:
    """Return the processor's name and a digest of what it can do, by which libraries choose."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    facts = dict(line.split(":", 1) for line in reversed(lines) if ":" in line)
    found = {key.strip(): value.strip() for key, value in facts.items()}
    features = " ".join(sorted(found.get("flags", found.get("Features", "")).split()))
    digest = hashlib.sha256(features.encode()).hexdigest()[:12]
    return f"{found.get('model name', platform.machine())}, features {digest}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """How many results were compared in either way, and a line for each that differs."""

    by_bits: int
    by_fingerprint: int
    lines: tuple[str, ...]


def compare(expected: Mapping[str, Any], found: Mapping[str, Any]) -> Comparison:
    """What `document` returned here with what it returned before, or elsewhere.

    Only the cases that `found` has are compared, each as a whole.
    """
    same_machine = expected["environment"] == found["environment"]
    lines, compared = [], 0
    for case, now in found["results"].items():
        before = expected["results"].get(case, {})
        lines += [f"{case}/{name}: was not there before" for name in now if name not in before]
        for name, old in before.items():
            if name not in now:
                lines.append(f"{case}/{name}: is not there any more")
                continue
            compared += 1
            prints = (old["fingerprint"], now[name]["fingerprint"])
            if not same_machine:
                if words := unlike(*prints, old["tolerance"]):
                    lines.append(f"{case}/{name}: {words}; tolerance {old['tolerance']:g}")
            elif old["sha256"] != now[name]["sha256"]:
                words = unlike(*prints, EXACT) or f"by some {EXACT:g} of the whole at most"
                lines.append(f"{case}/{name}: other bits: {words}")
    return Comparison(*((compared, 0) if same_machine else (0, compared)), tuple(lines))


# The table of cases

Values = Mapping[str, Any]
"""Results by name: arrays, numbers, or a `Result`."""


@dataclass(frozen=True, slots=True)
class Case:
    """Something to compute from the shared inputs; if it is not `cheap`, tests do so at night."""

    name: str
    compute: Callable[[Works], Values]
    tolerance: float
    cheap: bool

    def results(self, works: Works) -> dict[str, Result]:
        return {k: as_result(v, self.tolerance) for k, v in self.compute(works).items()}


CASES: dict[str, Case] = {}


def case(
    tolerance: float, *, cheap: bool = True
) -> Callable[[Callable[[Works], Values]], Callable[[Works], Values]]:
    """Put a function into the table of cases."""

    def add(function: Callable[[Works], Values]) -> Callable[[Works], Values]:
        CASES[function.__name__] = Case(function.__name__, function, tolerance, cheap)
        return function

    return add


def as_result(value: Any, tolerance: float) -> Result:
    return value if isinstance(value, Result) else Result(np.asarray(value), tolerance)


def within(tolerance: float, **values: Any) -> dict[str, Result]:
    """Return results with another tolerance than their case's."""
    return {name: as_result(value, tolerance) for name, value in values.items()}


def named(prefix: str, values: Values) -> dict[str, Any]:
    return {f"{prefix} {name}": value for name, value in values.items()}


# Inputs that several cases share


@dataclass(frozen=True)
class Works:
    """Small inputs, made on first use; data sets alone open the device by its name."""

    device: clradar.Device
    folder: Path

    @cached_property
    def array(self) -> clradar.AntennaArray:
        """Every eighth antenna, 12 x 12."""
        return thinned(8)

    @cached_property
    def waveform(self) -> clradar.Waveform:
        return clradar.Waveform.sfcw(72e9, 82e9, 16)

    @cached_property
    def mesh(self) -> clradar.hand.HandMesh:
        return clradar.hand.hand_mesh("F", edge_length_m=4e-3, device=self.device)

    @cached_property
    def hand(self) -> clradar.Scene:
        """Of one alpha, with its parts and normals."""
        m = self.mesh
        return clradar.Scene(m.vertices_m, m.faces, 0.4, m.part, m.part_names, m.normals)

    @cached_property
    def parts(self) -> clradar.Scene:
        """Each part of the hand with an alpha of its own."""
        alphas = {name: 0.1 + 0.15 * i for i, name in enumerate(self.mesh.part_names)}
        return self.hand.with_alpha(alphas)

    @cached_property
    def wave(self) -> clradar.Scene:
        """A wavy plate of 5 cm, in two halves."""
        return wavy_plate()

    @cached_property
    def stochastic(self) -> clradar.Capture:
        return self.simulated(self.hand, samples_per_mm2=0.5, rays_per_sample=2, seed=1)

    @cached_property
    def expected(self) -> clradar.Capture:
        return self.simulated(self.hand, samples_per_mm2=0.1, estimator="expected", seed=2)

    def simulated(self, scene: clradar.Scene, **settings: Any) -> clradar.Capture:
        return clradar.simulate(scene, self.array, self.waveform, device=self.device, **settings)

    @cached_property
    def grid(self) -> clradar.VoxelGrid:
        """41 x 51 x 9 voxels around the hand."""
        return clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.1, 0.1), (0.26, 0.34), 4e-3)

    @cached_property
    def image(self) -> clradar.Volume:
        return self.imaged(self.expected)

    @cached_property
    def other_image(self) -> clradar.Volume:
        return self.imaged(self.stochastic)

    def imaged(self, capture: clradar.Capture, **options: Any) -> clradar.Volume:
        options = {"method": "exact", **options}
        return clradar.backproject(capture, self.grid, device=self.device, **options)

    @cached_property
    def small_hand(self) -> clradar.Scene:
        """Half as large as a hand, and so with a quarter of the rays."""
        half = np.diag([0.5, 0.5, 0.5, 1.0])
        half[2, 3] = 0.15
        return self.hand.transformed(half)

    @property
    def radar(self) -> dict[str, Any]:
        """The whole array, 32 frequencies and the device, as arguments."""
        waveform = clradar.Waveform.sfcw(72e9, 82e9, 32)
        return {"array": clradar.arrays.qar50(), "waveform": waveform, "device": self.device}

    @cached_property
    def measured(self) -> clradar.Volume:
        """The image of the small hand where it is to be found."""
        scene = self.small_hand.transformed(motion(0.1, (0.006, -0.005, 0.004)))
        capture = clradar.simulate(
            scene, samples_per_mm2=4.0, rays_per_sample=3, seed=16, **self.radar
        )
        extent_m = (-0.064, 0.064)
        grid = clradar.VoxelGrid.from_extent(extent_m, extent_m, (0.272, 0.328), 4e-3)
        return clradar.backproject(capture, grid, device=self.device)

    @cached_property
    def points(self) -> clradar.Capture:
        """Five points, by the host alone, 12 x 12 antennas and 32 frequencies."""
        return points(self.array, 32)

    @cached_property
    def walls(self) -> clradar.Capture:
        """Two walls and a lamp."""
        return clradar.room_capture(
            self.array,
            self.points.waveform,
            [
                clradar.Wall(np.array([0, 0, 0.9]), np.array([0, 0, -1]), 2.0),
                clradar.Wall(np.array([0.7, 0, 0]), np.array([-1, 0, 0.2]), -1.0),
            ],
            points_m=[[0.2, 0.1, 0.5]],
            point_amplitudes=[0.5j],
        )


def thinned(every: int) -> clradar.AntennaArray:
    """Return the imager with only every so many antennas."""
    whole = clradar.arrays.qar50()
    return clradar.AntennaArray(whole.tx_m[::every], whole.rx_m[::every], "thinned")


def points(array: clradar.AntennaArray, steps: int) -> clradar.Capture:
    """Return a capture of five points around (0, 0, 0.3) m."""
    where = [[0, 0, 0.3], [0.03, -0.02, 0.29], [-0.04, 0.03, 0.31], [0.02, 0.05, 0.3]]
    return clradar.room_capture(
        array,
        clradar.Waveform.sfcw(72e9, 82e9, steps),
        [],
        points_m=[*where, [-0.03, -0.05, 0.32]],
        point_amplitudes=[1, 0.8j, -0.7, 0.6 + 0.3j, 0.9],
    )


def wavy_plate() -> clradar.Scene:
    """Return waves of 3 mm on a square of 5 cm at 0.3 m, its halves called left and right."""
    vertices, faces = plate(0.05, 0.3, 12, wavy_m=3e-3)
    left = (vertices[faces][:, :, 0].mean(axis=1) > 0).astype(np.int32)
    return clradar.Scene(vertices, faces, 0.5, left, ("left", "right"))


def motion(turn_rad: float, shift_m: tuple[float, float, float]) -> np.ndarray:
    """Return a turn about an axis through (0, 0, 0.3) m along (1, 2, 2), then a shift; (4, 4)."""
    x, y, z = np.array([1.0, 2.0, 2.0]) / 3.0
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(turn_rad) * cross + (1 - np.cos(turn_rad)) * cross @ cross
    centre_m = np.array([0.0, 0.0, 0.3])
    moved = np.eye(4)
    moved[:3, :3] = turn
    moved[:3, 3] = centre_m - turn @ centre_m + shift_m
    return moved


def placed(alignment: calibration.Alignment) -> dict[str, Any]:
    """Return a rigid motion as turn and shift, which have scales of their own."""
    transform = alignment.transform
    return {"turn": transform[:3, :3], "shift": transform[:3, 3]}


def of_capture(capture: clradar.Capture) -> dict[str, Any]:
    return {
        "data": capture.data,
        **within(
            EXACT,
            tx=capture.array.tx_m,
            rx=capture.array.rx_m,
            frequencies=capture.waveform.frequencies_hz,
        ),
    }


def of_depth(depth: clradar.DepthMap) -> dict[str, Any]:
    return {
        **{"depth": depth.depth_m, "amplitude": depth.amplitude, "mask": depth.mask},
        **within(EXACT, x=depth.x_m, y=depth.y_m),
    }


def of_metrics(metrics: clradar.Metrics) -> np.ndarray:
    return np.array([getattr(metrics, name) for name in (*METRICS, "dynamic_range_db")])


def of_paths(paths: clradar.Paths) -> dict[str, Any]:
    """By pair what the columns add up to."""
    n_pairs = paths.n_tx * paths.n_rx
    found: dict[str, Any] = {"number by pair": np.bincount(paths.pair, minlength=n_pairs)}
    for name in ("length_m", "amplitude", "bounces"):
        column = getattr(paths, name).astype(np.float64)
        found[f"{name} by pair"] = np.bincount(paths.pair, column, n_pairs)
    assert paths.statistics is not None
    return {**found, "statistics": np.array(list(asdict(paths.statistics).values()))}


# Hands


@case(EXACT)
def hand_draws(works: Works) -> Values:
    """Poses and shapes that are drawn, skeletons, poses between two, and a pose from a file."""
    hand = clradar.hand
    found: dict[str, Any] = {}
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        pose, shape = hand.random_pose(rng), hand.random_shape(rng)
        found[f"pose {seed}"] = angles(pose)
        sizes = (shape.length_m, shape.breadth_m, *shape.finger_lengths, shape.girth)
        found[f"shape {seed}"] = np.array(sizes)
        skeleton = hand.posed_skeleton(pose, shape)
        found[f"joints {seed}"], found[f"frames {seed}"] = skeleton.joints_m, skeleton.frames
    found["all poses"] = np.stack([angles(hand.POSES[name]) for name in sorted(hand.POSES)])
    between = hand.interpolate_poses(hand.pose_by_name("a"), hand.pose_by_name("Y"), 0.3)
    found["between"] = angles(between)
    hand.write_pose(works.folder / "pose.toml", between)
    found["read"] = angles(hand.read_pose(works.folder / "pose.toml"))
    return found


def angles(pose: clradar.hand.HandPose) -> np.ndarray:
    """Return the angles of all joints, shape (25, 3), radians."""
    joints = [pose.angles(name) for name in clradar.hand.JOINT_NAMES]
    return np.array([(j.flexion_rad, j.abduction_rad, j.twist_rad) for j in joints])


@case(SUMMED)
def hand_meshes(works: Works) -> Values:
    """Letters, a left hand of another size elsewhere, a drawn, a finer and a moved hand, joints."""
    hand, on = clradar.hand, {"device": works.device}
    shape = hand.HandShape(0.17, 0.076, (0.95, 1.05, 1.0, 1.02, 0.97), 1.1)
    rng = np.random.default_rng(5)
    turn = motion(0.4, (0.01, 0.0, 0.02))
    meshes = {
        "F": works.mesh,
        "Y": hand.hand_mesh("Y", 4e-3, "left", (0.01, -0.02, 0.28), shape, **on),
        "drawn": hand.hand_mesh(hand.random_pose(rng), 4e-3, shape=hand.random_shape(rng), **on),
        "fine": hand.hand_mesh("7", 2e-3, **on),
        "moved": works.mesh.moved(turn[:3, :3], turn[:3, 3]),
    }
    found: dict[str, Any] = {"joints": hand.hand_mesh("L", handedness="left", **on).joints_m}
    for name, mesh in meshes.items():
        normals = np.zeros((0, 3)) if mesh.normals is None else mesh.normals
        values = {"vertices": mesh.vertices_m, "faces": mesh.faces, "joints": mesh.joints_m}
        found |= named(name, {**values, "part": mesh.part, "normals": normals})
    return found


@case(SUMMED)
def rig(works: Works) -> Values:
    """A rigged hand from a glTF file in two poses, by way of a data set's recipes."""
    RigMaker().save(works.folder / "hand.glb")
    path = works.folder / "rig.toml"
    path.write_text(
        "samples = 2\n[poses]\nnames = ['B', 'Y']\n[hands]\nrigs = ['hand.glb']\n"
        "handedness = 'both'\n[output]\nproducts = ['mesh', 'joints']\n"
    )
    plan = clradar.dataset.read_plan(path)
    found: dict[str, Any] = {}
    for i in range(plan.samples):
        recipe = clradar.dataset.recipe(plan, i)
        sample = clradar.dataset.make_sample(recipe, works.device, rigs=works.folder)
        found |= named(str(i), sample.arrays)
    return found


# Scenes

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-20 -30 300
25 -30 305
25 35 310
-20 35 305
3 0 1 2
3 0 2 3
"""


@case(EXACT)
def scenes(works: Works) -> Values:
    """Meshes from a file and from memory, moved, put together; regions of their faces."""
    (works.folder / "plate.ply").write_text(PLY)
    move = motion(0.2, (0.01, 0.02, -0.01))
    read = clradar.Scene.from_mesh(
        str(works.folder / "plate.ply"), alpha=0.3, unit="mm", transform=move
    )
    bare = clradar.Scene.from_mesh(works.mesh, alpha=np.linspace(0, 1, len(works.mesh.faces)))
    both = clradar.Scene.combine([works.wave.transformed(move), read])
    regions = calibration.Regions
    found: dict[str, Any] = {
        "fingers": regions.of_fingers(works.parts).face,
        "labels": regions.of_labels(list("abca")).face,
    }
    for name, scene in {"read": read, "bare": bare, "parts": works.parts, "both": both}.items():
        # Those of hands come from the device.
        found |= within(SUMMED, **{f"{name} triangles": scene.triangles_m})
        found[f"{name} alpha"], found[f"{name} part"] = scene.alpha, scene.part
    return found


# Rays and captures


@case(TRACED)
def paths(works: Works) -> Values:
    """By density; with amplitudes that spread, and a pattern; as many samples on every face."""
    rays: dict[str, tuple[clradar.Scene, dict[str, Any]]] = {
        "one bounce": (works.parts, {"samples_per_mm2": 0.3, "rays_per_sample": 2, "seed": 3}),
        "two bounces": (works.hand, {
            "samples_per_mm2": 0.2, "rays_per_sample": 3, "max_bounces": 2, "seed": 2**63 + 5,
            "reception_radius_m": 0.015, "amplitude": "spreading", "pattern_exponent": 1.5,
        }),
        "per face": (works.hand, {
            "rays_per_face": 2, "normals": "face", "amplitude": "spreading", "seed": 4,
        }),
    }  # fmt: skip
    found: dict[str, Any] = {}
    for name, (scene, settings) in rays.items():
        traced = clradar.trace(scene, works.array, device=works.device, **settings)
        assert traced.bounces.max() == settings.get("max_bounces", 1)
        found |= named(name, of_paths(traced))
        if name == "one bounce":
            capture = clradar.synthesize(traced, works.array, works.waveform, device=works.device)
            found |= named("capture", of_capture(capture))
    return found


@case(TRACED)
def captures(works: Works) -> Values:
    """One alpha, and one per part: with two bounces, or amplitudes that spread."""
    stochastic: dict[str, Any] = {
        "samples_per_mm2": 0.3, "rays_per_sample": 2, "max_bounces": 2, "crease_deg": 50.0,
    }  # fmt: skip
    expected = {"samples_per_mm2": 0.1, "estimator": "expected", "amplitude": "spreading"}
    made = {
        "stochastic": works.stochastic,
        "stochastic parts": works.simulated(works.parts, seed=5, **stochastic),
        "expected": works.expected,
        "expected parts": works.simulated(works.parts, seed=6, **expected),
    }
    return {k: v for name, c in made.items() for k, v in named(name, of_capture(c)).items()}


@case(TRACED)
def capture_of_limits(works: Works) -> Values:
    """The scene put together from two and moved; alpha 0 and 1; tiles that a small memory needs."""
    beside = works.wave.transformed(motion(0.3, (0.06, 0.0, 0.0)))
    both = clradar.Scene.combine([works.wave.with_alpha(0.0), beside.with_alpha(1.0)])
    small = clradar.open_device(
        works.device.info.selector, memory_limit_bytes=2**21, width=works.device.width
    )
    capture = clradar.simulate(
        both, works.array, works.waveform, samples_per_mm2=1.0, rays_per_sample=4, seed=7,
        device=small,
    )  # fmt: skip
    return of_capture(capture)


# Images


@case(SUMMED)
def images(works: Works) -> Values:
    """Of points: by the sum as it stands, by range profiles, over the tree of blocks; windows."""
    own = np.linspace(0.2, 1.0, works.points.waveform.n_freq)
    grid = clradar.VoxelGrid.from_extent((-0.08, 0.08), (-0.08, 0.08), (0.27, 0.33), 2.5e-3)
    many = points(thinned(4), 32)
    assert many.data.size * np.prod(grid.shape) > 2**30, "the sum as it stands would be taken"
    tree = partial(clradar.backproject, many, grid, method="fast", device=works.device)
    found = {
        "exact rect": works.imaged(works.points, window="rect"),
        "exact taylor": works.imaged(works.points, window="taylor"),
        "range hann": works.imaged(works.points, method="range", window="hann"),
        "range own": works.imaged(works.points, method="range", window=own),
        "fast rect": tree(),
        "fast hann": tree(window="hann", tolerance_db=-40.0),
    }
    return {name: image.data for name, image in found.items()}


@case(TRACED)
def views(works: Works) -> Values:
    """Of hands: complex image, maximum projection, depth map, and what is written of them."""
    image, other = works.image, works.other_image
    depth = image.depth_map()
    metrics = clradar.compare(other, image)
    wide = clradar.compare(other, image, dynamic_range_db=25.0)
    return {
        **{"image": image.data, "other": other.data, "projection": image.max_projection()},
        **named("depth", of_depth(depth)),
        **named("wide depth", of_depth(image.depth_map(25.0))),
        **within(FOUND, metrics=of_metrics(metrics), wide_metrics=of_metrics(wide)),
    }


# Instruments


@case(STORED)
def room(works: Works) -> Values:
    """Walls and points, by the host."""
    return {**named("walls", of_capture(works.walls)), "points": works.points.data}


@case(EXACT)
def channels(works: Works) -> Values:
    """Gains and delays that are drawn, and what they are at a frequency."""
    drawn = clradar.draw_channels(works.array, works.waveform, seed=8, dead_tx=[3], gain_db=2.0)
    frequencies_hz = works.waveform.frequencies_hz
    return {
        **{"tx gain": drawn.tx_gain, "rx gain": drawn.rx_gain},
        **{"tx delay": drawn.tx_delay_s, "rx delay": drawn.rx_delay_s},
        "tx": drawn.tx_response(frequencies_hz),
        "rx": drawn.rx_response(frequencies_hz),
        "reference": drawn.reference_hz,
    }


@case(STORED)
def impairments(works: Works) -> Values:
    """All faults at once, and each by itself; of points, so that only the host computes."""
    array, waveform = works.array, works.points.waveform
    drawn = clradar.draw_channels(array, waveform, seed=9)
    drift = {"drift_phase_rad": 0.02, "drift_gain_db": 0.1, "drift_common_phase_rad": 0.1}
    faults: dict[str, dict[str, Any]] = {
        "room": {"room": works.walls},
        "coupling": {"coupling_db": 6.0, "coupling_delay_s": 5e-11},
        "channels": {"channels": drawn},
        "drift": {**drift, "frame": 3},
        "mixer": {"iq_gain_db": 0.3, "iq_phase_rad": np.linspace(-0.1, 0.1, array.n_rx)},
        "noise": {"snr_db": 15.0},
    }
    found: dict[str, Any] = {
        name: clradar.impair(works.points, seed=10, **settings).data
        for name, settings in faults.items()
    }
    # Steps of a converter turn a rounding into a step: 2^-11 of full scale, of few samples.
    converted = clradar.impair(works.points, seed=10, adc_bits=12)
    found |= within(1e-3, converter=converted.data)
    everything = {key: value for settings in faults.values() for key, value in settings.items()}
    whole = clradar.impair(works.points, seed=11, **everything, adc_bits=10)
    found |= within(1e-2, whole=whole.data)
    return found


# Calibration


@case(STORED)
def cleaning(works: Works) -> Values:
    """Gates, the empty room taken off in three ways, frames averaged, conventions undone."""
    waveform = works.points.waveform
    matrix, record = gate(waveform, near_m=0.27, far_m=0.36, clutter_db=30.0)
    drift: dict[str, Any] = {
        "drift_phase_rad": 0.01,
        "drift_gain_db": 0.05,
        "drift_common_phase_rad": 0.2,
    }
    frames = [
        clradar.impair(works.points, seed=12, frame=i, room=works.walls, snr_db=25.0, **drift)
        for i in range(3)
    ]
    nothing = clradar.Capture(np.zeros_like(works.points.data), works.array, waveform)
    empty = clradar.impair(nothing, seed=13, room=works.walls, snr_db=40.0, reference_power=1.0)
    gated = calibration.range_gate(frames[0], near_m=0.27, far_m=0.36)
    found: dict[str, Any] = {
        **within(1e-6, gate=matrix, numbers=np.array(list(record.values()))),
        **named("gated", of_capture(gated)),
        "mean": calibration.average_frames(frames).data,
        "aligned mean": calibration.average_frames(frames, align_phase=True).data,
    }
    for scaling in ("none", "common", "channel"):
        without = calibration.subtract_background(frames[1], empty, scaling=scaling)
        found[f"without, {scaling}"] = without.data
    for flags in itertools.product((False, True), repeat=4):
        hypothesis = calibration.Hypothesis(*flags)
        if hypothesis.changes:
            found[hypothesis.label] = calibration.apply_convention(frames[2], hypothesis).data
    return found


@case(STORED)
def target_responses(works: Works) -> Values:
    """What ideal channels record of the three targets."""
    return {
        target.kind: calibration.response(target, works.array, works.waveform) for target in TARGETS
    }


TARGETS: tuple[calibration.Target, ...] = (
    calibration.FlatPlate(0.300, 0.8, -0.5, size_m=(0.2, 0.2)),
    calibration.Sphere(np.array([0.004, -0.003, 0.335]), 0.05),
    calibration.CornerReflector(np.array([0.006, 0.004, 0.306])),
)


@case(1e-4)
def channel_estimates(works: Works) -> Values:
    """Channels by a plate and a sphere, 24 x 24 antennas, and a capture corrected by them.

    A fit is found to where its last step is 1e-6 or so of a phase; float32 data is good to 6e-8.
    """
    array, waveform = thinned(4), clradar.Waveform.sfcw(72e9, 82e9, 32)
    drawn = clradar.draw_channels(array, waveform, seed=14, dead_tx=[5], dead_rx=[20])
    scene = points(array, 32)
    found: dict[str, Any] = {}
    said: tuple[calibration.Target, ...] = (
        calibration.FlatPlate(0.304),
        calibration.Sphere(np.array([0.0, 0.0, 0.332]), 0.05),
    )
    true: tuple[calibration.Target, ...] = (calibration.FlatPlate(0.300, 0.8, -0.5), TARGETS[1])
    for at, target in zip(said, true, strict=True):
        ideal = clradar.Capture(calibration.response(target, array, waveform), array, waveform)
        recorded = clradar.impair(ideal, seed=15, channels=drawn, snr_db=20.0)
        known = calibration.estimate_channels(recorded, at)
        measured = clradar.impair(scene, seed=15, channels=drawn, snr_db=20.0)
        corrected = calibration.correct(measured, known)
        found |= named(
            target.kind,
            {
                "tx gain": known.response.tx_gain,
                "rx gain": known.response.rx_gain,
                "tx delay": known.response.tx_delay_s,
                "rx delay": known.response.rx_delay_s,
                "position": np.array(list(known.target_position.values())),
                "dead": np.concatenate([known.dead_tx, [-1], known.dead_rx]),
                "noisy": np.concatenate([known.noisy_tx, [-1], known.noisy_rx]),
                "tx noise": known.tx_noise,
                "rx noise": known.rx_noise,
                "levels": np.array([known.residual_db, known.noise_residual_db]),
                "amplitude": known.target_amplitude,
                "corrected": corrected.data,
            },
        )
    return found


@case(SUMMED)
def conventions(works: Works) -> Values:
    """Sharpness by each of eight hypotheses, of points that were written in one of them."""
    done = calibration.Hypothesis(conjugated=True, mirrored=True)
    capture = calibration.apply_convention(works.points, done)
    grid = clradar.VoxelGrid.from_extent((-0.06, 0.06), (-0.06, 0.06), (0.28, 0.33), 5e-3)
    diagnosis = calibration.diagnose(capture, grid=grid, device=works.device)
    return {
        "sharpness": np.array([10 ** (score.relative_db / 10) for score in diagnosis.scores]),
        "peaks": np.array([score.peak_m for score in diagnosis.scores]),
    }


@case(1e-6, cheap=False)
def alignment_of_images(works: Works) -> Values:
    """Two depth maps of an ellipsoid, by the host alone, one of them turned and shifted."""
    del works
    fixed, moved = ellipsoid(np.eye(4)), ellipsoid(motion(0.25, (0.012, -0.008, 0.01)))
    found = calibration.align(moved, fixed)
    return {**placed(found), "inliers": np.array([found.rms_m, found.inlier_share])}


def ellipsoid(transform: np.ndarray) -> clradar.DepthMap:
    """Return depths along z of a bumpless ellipsoid, half axes 40, 55 and 25 mm, around 0.3 m."""
    axis_m = np.arange(-40, 41) * 2e-3
    x, y = np.meshgrid(axis_m, axis_m)
    back = np.linalg.inv(transform)
    centre_m, half_m = np.array([0.0, 0.0, 0.3]), np.array([0.040, 0.055, 0.025])
    # A point of the ray through a pixel is begin + z along, in units of the half axes.
    begin = np.stack([x, y, 0 * x], axis=2) @ back[:3, :3].T + back[:3, 3] - centre_m
    begin, along = begin / half_m, back[:3, 2] / half_m
    a, b = along @ along, begin @ along
    root = b**2 - a * ((begin**2).sum(axis=2) - 1)
    depth_m = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)
    return clradar.DepthMap(depth_m, 1.0 * (root > 0), axis_m, axis_m, 15.0)


@case(FOUND, cheap=False)
def registration(works: Works) -> Values:
    """Of a small hand by its rendering, with and without the bias of that, and in two rounds."""
    given = (works.measured, works.small_hand)
    search: dict[str, Any] = {**works.radar, "search_deg": 5.0}
    closed = calibration.register(
        *given, fit_alpha=True, samples_per_mm2=2.0, rays_per_sample=2, max_rounds=2, **search
    )
    return {
        **named("coarse", placed(calibration.align_mesh(*given, correct_bias=False, **search))),
        **named("glints", placed(calibration.align_mesh(*given, **search))),
        **named("closed", placed(closed.alignment)),
    }


# Sweeps


@case(FOUND)
def alpha_sweeps(works: Works) -> Values:
    """Of a wavy plate: three alphas, two seeds; with one alpha, and with one for each half."""
    halves = calibration.Regions.of_parts(works.wave)
    return {**named("whole", swept(works, None)), **named("halves", swept(works, halves))}


def swept(works: Works, regions: calibration.Regions | None) -> Values:
    """Return images, metrics and estimates of a sweep over a wavy plate."""
    rays: dict[str, Any] = {
        **{"samples_per_mm2": 1.0, "rays_per_sample": 2, "reception_radius_m": 0.025},
    }
    radar: dict[str, Any] = {"array": works.array, "waveform": works.waveform}
    measured = clradar.simulate(
        works.wave.with_alpha({"left": 0.2, "right": 0.5}), **radar, **rays, seed=17,
        device=works.device,
    )  # fmt: skip
    grid = clradar.VoxelGrid.from_extent((-0.03, 0.03), (-0.03, 0.03), (0.285, 0.315), 3e-3)
    image = clradar.backproject(measured, grid, device=works.device)
    found = calibration.sweep(
        image, works.wave, [0.1, 0.4, 0.7], seeds=2, regions=regions, device=works.device,
        **radar, **rays,
    )  # fmt: skip
    images = [image.amplitude for image in found.images if image is not None]
    values: dict[str, Any] = {
        "measured": found.measured.amplitude,
        "images": np.stack(images),
        "metrics": np.array([[of_metrics(m) for m in row] for row in found.metrics]),
        "probability": found.estimate.probability,
    }
    for one in found.regions:
        values[f"probability of {one.name}"] = one.probability
    return values


# Physical surfaces, movement, antennas


SKIN = clradar.Material("skin", permittivity=6.56 - 8.91j)

WET = clradar.Material(
    "wet", permittivity=6.56 - 8.91j, roughness_rms_m=0.05e-3, correlation_length_m=1e-3
)


@case(POINTS)
def captures_physical(works: Works) -> Values:
    """A conductor, skin, a rough skin, the palm of the table, and two parts of two materials."""
    surfaces = {
        "metal": works.wave.with_material("metal"),
        "skin": works.wave.with_material(SKIN),
        "rough": works.wave.with_material(WET),
        "palm": works.wave.with_material("palm"),
        "two": works.wave.with_material({"left": SKIN, "right": "metal"}),
        "hand": works.small_hand.with_material(SKIN),
    }
    found: dict[str, Any] = {}
    for name, scene in surfaces.items():
        capture = works.simulated(scene, estimator="physical", samples_per_mm2=1.5, seed=3)
        found |= named(name, of_capture(capture))
    image = works.imaged(works.simulated(surfaces["metal"], estimator="physical"))
    bright = np.abs(image.data) > 0.1 * np.abs(image.data).max()
    return {**found, "metal rcs": image.rcs_dbsm()[bright]}


@case(TRACED)
def captures_of_movement(works: Works) -> Values:
    """A plate that falls and a hand that opens during a sweep, by two estimators."""
    timing = clradar.SweepTiming.in_order(works.array.n_tx, works.waveform.n_freq, step_s=50e-6)
    fall = clradar.RigidMotion.steady(velocity_m_per_s=(0.1, -1.0, 0.2))
    opening = clradar.MovingHand([0.0, 0.4], ["S", "flat"], edge_length_m=4e-3)
    bodies = {
        "plate": (clradar.MovingBody(works.wave, fall), {"samples_per_mm2": 0.3}),
        "skin": (
            clradar.MovingBody(works.wave.with_material(SKIN), fall),
            {"estimator": "physical", "samples_per_mm2": 1.5},
        ),
        "hand": (opening, {"estimator": "expected", "samples_per_mm2": 0.05}),
    }
    found: dict[str, Any] = {}
    for name, (body, settings) in bodies.items():
        capture = clradar.simulate_moving(
            clradar.MovingScene([body]), works.array, works.waveform, timing=timing, seed=2,
            device=works.device, **settings,
        )  # fmt: skip
        found[f"{name} data"] = capture.data
    return found


@case(POINTS)
def captures_of_antennas(works: Works) -> Values:
    """Patterns by exponent and by table, gains, boresights and poses of single antennas."""
    tx_m, rx_m = works.array.tx_m, works.array.rx_m
    table = clradar.AntennaPattern(angle_deg=[0, 20, 40, 180], field=[1, 0.8, 0.1, 0])
    leaning = np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
    arrays = {
        "patterns": {"tx_pattern": clradar.AntennaPattern(6.0, exponent=2.0), "rx_pattern": table},
        "gains": {"tx_gain": np.exp(0.3j * np.arange(12)), "rx_gain": np.linspace(0.5, 2, 12)},
        "boresights": {"tx_boresight": np.tile(leaning, (12, 1)), "tx_pattern": table},
    }
    found: dict[str, Any] = {}
    for name, fields in arrays.items():
        array = clradar.AntennaArray(tx_m, rx_m, **fields)
        for surface, estimator in ((SKIN, "physical"), (None, "expected")):
            if estimator == "expected" and array.has_patterns:
                continue
            scene = works.wave if surface is None else works.wave.with_material(surface)
            capture = clradar.simulate(
                scene, array, works.waveform, estimator=estimator, samples_per_mm2=1.5,
                device=works.device,
            )  # fmt: skip
            found[f"{name} {estimator}"] = capture.data
    (works.folder / "clusters.toml").write_text(
        'pairs = "cluster"\n'
        "[[tx]]\nline = { first_m = [-0.02, 0, 0], last_m = [0.02, 0, 0], n = 6 }\n"
        "[[rx]]\nline = { first_m = [0, -0.02, 0], last_m = [0, 0.02, 0], n = 6 }\n"
        "[[pose]]\nplane = { size_m = [0.1, 0.05], n = [2, 1] }\n"
    )
    clusters = clradar.arrays.read_clusters(works.folder / "clusters.toml")
    captures = [
        clradar.simulate(works.wave, one, works.waveform, device=works.device, estimator="expected")
        for one in clusters
    ]
    image = clradar.backproject(captures, works.grid, device=works.device, method="exact")
    return {**found, "clusters": image.data}


# Images by operators


@case(SUMMED)
def images_by_operators(works: Works) -> Values:
    """The forward operator of points and of voxels, its adjoint, and model-based images."""
    rng = np.random.default_rng(6)
    points_m = rng.uniform([-0.03, -0.03, 0.28], [0.03, 0.03, 0.31], (300, 3))
    values = rng.standard_normal(300) + 1j * rng.standard_normal(300)
    radar = (works.array, works.waveform)
    grid = clradar.VoxelGrid.from_extent((-0.02, 0.02), (-0.02, 0.02), (0.29, 0.31), 2e-3)
    voxels = clradar.ImagingOperator(*radar, grid, device=works.device)
    cloud = clradar.ImagingOperator(*radar, points_m, device=works.device)
    filled = rng.standard_normal(grid.shape) + 1j * rng.standard_normal(grid.shape)
    capture = clradar.forward(points_m, values, *radar, device=works.device)
    found = {
        "forward": capture.data,
        "forward of voxels": voxels.forward(filled.astype(np.complex64)),
        "adjoint to voxels": voxels.adjoint(capture.data),
        "adjoint to points": cloud.adjoint(capture.data),
    }
    few = clradar.VoxelGrid.from_extent((-0.02, 0.02), (0, 0), (0.3, 0.3), 1e-3)
    for method in ("least-squares", "sparse"):
        image = clradar.reconstruct(
            works.points, few, method=method, iterations=5, check_grid=False, device=works.device
        )
        found |= within(1e-3, **{method.replace("-", "_"): image.data})
    return found


@case(SUMMED)
def frames_on_the_device(works: Works) -> Values:
    """One frame after the other, and a simulation that is imaged where it is."""
    grid = clradar.VoxelGrid.from_extent((-0.04, 0.04), (-0.04, 0.04), (0.27, 0.33), 2e-3)
    found: dict[str, Any] = {}
    with clradar.FrameImager(works.array, works.waveform, grid, device=works.device) as imager:
        for name, scale in (("first", 1.0), ("second", 2.0j)):
            frame = points(works.array, works.waveform.n_freq)
            imager.form(clradar.Capture(scale * frame.data, works.array, works.waveform, {}))
            found[name] = imager.volume().data
            found |= named(name, of_depth(imager.depth_map()))
        clradar.simulate_image(works.wave, imager, seed=1)
        found |= within(TRACED, simulated=imager.volume().data)
    return found


@case(1e-6)
def placed_grids(works: Works) -> Values:
    """Grids around echoes: the points, all of them, and a hand."""
    placed_at = {
        "points": clradar.place_grid(works.points, device=works.device),
        "everything": clradar.place_grid(works.points, everything=True, device=works.device),
        "hand": clradar.place_grid(works.expected, device=works.device),
    }
    return {
        name: np.stack([grid.origin_m, grid.spacing_m, grid.counts])
        for name, grid in placed_at.items()
    }


@case(FOUND, cheap=False)
def hand_fit(works: Works) -> Values:
    """A hand from its image, without the simulations that judge it."""
    pose = clradar.hand.pose_by_name("F")
    scene = clradar.Scene.from_mesh(
        clradar.hand.hand_mesh(pose, 4e-3, device=works.device), alpha=0.5
    )
    capture = clradar.simulate(scene, seed=4, **works.radar)
    grid = clradar.VoxelGrid.from_extent((-0.09, 0.09), (-0.099, 0.099), (0.26, 0.341), 3e-3)
    image = clradar.backproject(capture, grid, device=works.device)
    fit = calibration.fit_hand(image, "F", closed_loop=False, alpha=0.5, **works.radar)
    return {"joints": fit.joints_m, "angles": angles(fit.pose)}


# Data sets


@case(TRACED)
def data_set(works: Works) -> Values:
    """Samples of a data set as they are read."""
    plan = plan_of(samples=3, poses={"names": ["A", "F"]})
    folder = works.folder / "set"
    result = clradar.dataset.run(plan, folder, device="pocl")
    assert (result.made, result.aside) == (3, ())
    found: dict[str, Any] = {}
    with clradar.dataset.open_dataset(folder) as view:
        for name, column in view.variables.items():
            values = np.asarray(column.values)
            if values.dtype.kind in "biufc":
                found[f"read {name}"] = values
    meshes = [clradar.dataset.read_sample(folder, i).arrays for i in range(3)]
    for name in ("mesh_vertices", "mesh_faces", "mesh_part"):
        found[f"read {name}"] = np.concatenate([arrays[name] for arrays in meshes])
    return found


@case(POINTS, cheap=False)
def data_set_physical(works: Works) -> Values:
    """Samples of a data set of the physical estimator."""
    plan = plan_of(
        samples=3, poses={"names": ["A", "F"]}, alpha=None,
        material={"others": "skin", "palm": "palm"},
        simulation={"estimator": "physical", "samples_per_mm2": 1.5},
    )  # fmt: skip
    found: dict[str, Any] = {}
    for i in range(2):
        recipe = clradar.dataset.recipe(plan, i)
        sample = clradar.dataset.make_sample(recipe, works.device)
        found |= named(str(i), {k: v for k, v in sample.arrays.items() if v.dtype.kind in "fc"})
    return found


# The documents


def document(device: clradar.Device, *, only: Iterable[str] = ()) -> dict[str, Any]:
    """Compute the named cases, or all; their digests as JSON."""
    chosen = [c for c in CASES.values() if not only or c.name in only]
    results = {}
    # Results without a device option use the same one.
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.dict(os.environ, {"CLRADAR_DEVICE": device.info.selector}),
    ):
        works = Works(device, Path(folder))
        for c in chosen:
            results[c.name] = {k: r.record() for k, r in sorted(c.results(works).items())}
    return {
        "environment": environment(device),
        "clradar": clradar.__version__,
        "results": results,
    }


def text_of(made: Mapping[str, Any]) -> str:
    """Return a document as JSON with a line for each result."""
    cases = []
    for name, results in made["results"].items():
        rows = [f"   {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in results.items()]
        cases.append(f"  {json.dumps(name)}: {{\n" + ",\n".join(rows) + "\n  }")
    head = json.dumps({key: value for key, value in made.items() if key != "results"}, indent=1)
    return head[:-2] + ',\n "results": {\n' + ",\n".join(cases) + "\n }\n}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--write", type=Path, metavar="FILE.json", required=True)
    parser.add_argument("--width", type=int, choices=(1, 8), help="lanes, to round otherwise")
    given = parser.parse_args()
    device = clradar.open_device("pocl", width=given.width)
    made = document(device)
    given.write.write_text(text_of(made))


if __name__ == "__main__":
    main()
