"""Options of a simulation: rays, meshes with their alphas and materials, and how they move."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

import clradar as cl
from clradar.cli.options.common import (
    Amplitude,
    UnitOptions,
    WorkerOptions,
)
from clradar.cli.options.groups import argument, given, option, recorded, wrong_usage
from clradar.cli.outputs import check_folder, check_outputs
from clradar.cli.parse import ALL, FRAMES_METAVAR, check_unit
from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.errors import ModelError, warn
from clradar.geometry.normals import CREASE_DEG
from clradar.tracing.settings import (
    EXPECTED_SAMPLES_PER_MM2,
    RAYS_PER_SAMPLE,
    SAMPLES_PER_MM2,
    SimulationSettings,
)
from clradar.tracing.suited import RECEPTION_RADIUS_M

if TYPE_CHECKING:
    from clradar.motion.motion_file import Motion

Estimator = Literal["stochastic", "expected", "physical"]

ESTIMATORS = (
    "stochastic: random outgoing rays, as in the paper; expected: their mean, without shot noise, "
    f"from {EXPECTED_SAMPLES_PER_MM2:g} sample per square millimetre; physical: S-parameters of "
    "the materials by the Kirchhoff sum, without alpha."
)


@dataclass(frozen=True, kw_only=True)
class SamplingOptions:
    """How densely rays are launched."""

    samples_per_mm2: float | None = option(
        None,
        f"Surface samples per square millimetre. [default: {SAMPLES_PER_MM2:g} if stochastic]",
        metavar="N",
    )
    rays_per_sample: int | None = option(
        None,
        f"Rays per sample and Tx. [default: {RAYS_PER_SAMPLE}; 1 if samples are given per face]",
        metavar="N",
    )


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(SamplingOptions):
    """How rays are launched, reflected and received."""

    rays_per_face: int | None = option(
        None, "Samples on every face, instead of a density.", metavar="N"
    )
    reception_radius_mm: float | None = option(
        None,
        f"A ray this near to an Rx is received. [default: {1e3 * RECEPTION_RADIUS_M:g}; of random "
        "rays what suits range and frequency]",
        metavar="MM",
    )
    max_bounces: int = option(1, "Reflections per path at most.", metavar="N")
    normals: Literal["smooth", "face"] = option(
        "smooth", "Interpolated from the vertices, or the faces'."
    )
    crease_deg: float = option(CREASE_DEG, "Edges sharper than this stay sharp.", metavar="DEG")
    facets: Literal["curved", "flat"] = option(
        "curved", "Paths end on the surface that the normals describe, or on the flat faces."
    )
    amplitude: Amplitude = option("unit", "1 per path, or 1/(R1 R2).")
    pattern_exponent: float = option(
        0.0, "With --amplitude spreading: antennas have the pattern cos(angle)^P.", metavar="P"
    )

    def settings(self, **more: Any) -> SimulationSettings:
        """The settings of the simulation; `more` are seed and estimator."""
        fields = recorded(self)
        radius_mm = fields.pop("reception_radius_mm")
        radius_m = None if radius_mm is None else radius_mm / 1e3
        if radius_mm is not None:
            check_unit("--reception-radius-mm", "a radius", radius_mm, PLAUSIBLE_RADIUS_M, "mm")
        return SimulationSettings(**fields, reception_radius_m=radius_m, **more)


@dataclass(frozen=True, kw_only=True)
class PlacementOptions(UnitOptions):
    """Unit and position of meshes."""

    transform: Path | None = option(
        None,
        "4 x 4 matrix, row-major, metres, that moves the meshes into the antenna frame; or the "
        "alignment.json of a recording, for its own.",
        metavar="T.json",
    )

    @property
    def files(self) -> list[Path]:
        """The file of the transform, if there is one."""
        return [] if self.transform is None else [self.transform]

    def matrix(self) -> np.ndarray | None:
        """The transform, shape (4, 4); None if there is none."""
        from measurement_io import read_transform

        return None if self.transform is None else read_transform(self.transform)


DEFAULT_ALPHA = 0.5


@dataclass(frozen=True, kw_only=True)
class AlphaOptions:
    """The alpha of the meshes, and of named parts."""

    alpha: list[str] | None = option(
        None,
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
    )


def read_part_alphas(values: Sequence[str]) -> tuple[float, dict[str, float]]:
    """The alpha of the parts that are not named, and that of each named part."""
    default = None
    by_part: dict[str, float] = {}
    for text in values:
        name, equals, number = text.rpartition("=")
        try:
            value = read_alpha("--alpha", number)
        except ValueError:
            raise wrong_usage(
                "--alpha", f"expected a number or PART=number, got '{text}'"
            ) from None
        if equals:
            if name in by_part:
                raise wrong_usage("--alpha", f"part '{name}' is given twice")
            by_part[name] = value
        elif default is not None:
            raise wrong_usage("--alpha", "expected one value without a part's name, got two")
        else:
            default = value
    return DEFAULT_ALPHA if default is None else default, by_part


def read_alpha(option: str, text: str) -> float:
    """The alpha in the text of an option."""
    value = float(text)
    if not (math.isfinite(value) and 0.0 <= value <= 1.0):
        raise wrong_usage(option, f"expected an alpha in [0, 1], got '{text}'")
    return value


def with_part_alphas(scene: cl.Scene, by_part: Mapping[str, float]) -> cl.Scene:
    """The scene with the alpha of each named part; all else keeps its own."""
    unknown = sorted(set(by_part) - set(scene.part_names))
    if unknown:
        raise ModelError(
            f"--alpha: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(unknown)}"
        )
    values = np.array(scene.alpha)
    for name, value in by_part.items():
        values[np.asarray(scene.part) == scene.part_names.index(name)] = value
    return scene.with_alpha(values)


PHYSICAL: Final = "physical"


@dataclass(frozen=True, kw_only=True)
class MaterialOptions:
    """What the meshes are made of."""

    material: str | None = option(
        None,
        "What the meshes are made of, which chooses the physical estimator: a name that "
        "`clradar materials` lists, or one of a file. [default: a perfect conductor]",
        metavar="NAME|FILE.toml:NAME",
    )
    material_of: list[str] | None = option(
        None,
        "The same of a part; may be repeated: --material palm --material-of thumb=skin.",
        metavar="PART=NAME",
    )
    materials: list[Path] | None = option(
        None, "Files whose materials have names, too; may be repeated.", metavar="FILE.toml"
    )

    @property
    def given(self) -> bool:
        """Whether a mesh gets a material."""
        return self.material is not None or bool(self.material_of)

    @property
    def files(self) -> list[Path]:
        """The files that are read, each once."""
        texts = [self.material, *(text.rpartition("=")[2] for text in self.material_of or [])]
        named = [_split(text)[0] for text in texts if text is not None]
        return list(dict.fromkeys([*(self.materials or []), *(f for f in named if f is not None)]))

    def estimator(self, chosen: Estimator | None) -> Estimator | None:
        """The estimator: `chosen`, or with a material the one that knows materials.

        Warns of a material that another one does not use.
        """
        if not self.given or chosen == PHYSICAL:
            return chosen
        if chosen is None:
            return PHYSICAL
        warn(f"--material: not used by --estimator {chosen}; {PHYSICAL} knows materials")
        return chosen

    def on(self, scene: cl.Scene) -> cl.Scene:
        """The scene of these materials."""
        known = self._known()
        if self.material is not None:
            scene = scene.with_material(_found("--material", self.material, known))
        by_part: dict[str, cl.Material] = {}
        for text in self.material_of or []:
            part, equals, name = text.rpartition("=")
            if not equals or not part:
                raise wrong_usage("--material-of", f"expected PART=NAME, got '{text}'")
            if part in by_part:
                raise wrong_usage("--material-of", f"part '{part}' is given twice")
            by_part[part] = _found("--material-of", name, known)
        unknown = sorted(set(by_part) - set(scene.part_names))
        if unknown:
            raise ModelError(
                f"--material-of: expected parts of the meshes ({', '.join(scene.part_names)}), got "
                f"{', '.join(unknown)}"
            )
        return scene.with_material(by_part) if by_part else scene

    def _known(self) -> dict[str, cl.Material]:
        from clradar.model.known_materials import KNOWN

        known = dict(KNOWN)
        for path in self.materials or []:
            own = cl.read_materials(path)
            hidden = sorted(set(own) & set(known))
            if hidden:
                warn(f"--materials: {path} has its own {', '.join(hidden)}, which hide known ones")
            known.update(own)
        return known


def _split(text: str) -> tuple[Path | None, str]:
    """File and name of ``FILE.toml:NAME``; no file in front of a plain name."""
    from clradar.model.material_file import SUFFIXES

    file, colon, name = text.rpartition(":")
    if colon and file.lower().endswith(SUFFIXES):
        return Path(file), name
    return None, text


def _found(option: str, text: str, known: dict[str, cl.Material]) -> cl.Material:

    file, name = _split(text)
    if file is not None:
        known = cl.read_materials(file)
    if name not in known:
        where = " or FILE.toml:NAME" if file is None else f" of {file}"
        raise wrong_usage(option, f"expected one of {', '.join(known)}{where}, got '{name}'")
    return known[name]


TRUTH = "truth"
"""Folder beside the frames with what a recording was made of."""

CLUSTER_NAME = "cluster_{:03d}"
"""Capture or recording of one cluster, in the folder of all."""

MAX_FRAMES = 10_000


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Movement, and frames of it."""

    motion: Path | None = option(
        None,
        "How meshes and hands move, and when the imager records each sample (docs/movement.md).",
        metavar="MOTION.toml",
    )
    frames: int | None = option(
        None, "Make a recording of so many frames, instead of one capture.", metavar="N"
    )
    rate_hz: float = option(8.0, "Frames per second; the first begins at time 0.", metavar="HZ")

    def __post_init__(self) -> None:
        if self.motion is None:
            for name in given(self):
                raise wrong_usage(name, "expected together with --motion")
        if self.frames is not None and not 1 <= self.frames <= MAX_FRAMES:
            raise wrong_usage("--frames", f"expected 1 to {MAX_FRAMES}, got {self.frames}")
        if not 0 < self.rate_hz < float("inf"):
            raise wrong_usage("--rate-hz", f"expected a positive number, got {self.rate_hz:g}")

    def read(self) -> Motion | None:
        """What the motion file says."""
        from clradar.motion.motion_file import read_motion

        return None if self.motion is None else read_motion(self.motion)

    def check(self, output: Path, *, several: bool, force: bool, inputs: Iterable[Path]) -> None:
        """Raise unless the capture, the recording or those of several clusters may be written."""
        if self.frames is None and not several:
            check_outputs([output], force=force, inputs=inputs)
        else:
            check_folder(output, force=force, replaced=replaced_in(output), inputs=inputs)


def replaced_in(folder: Path) -> list[str]:
    """What a recording of this command replaces in a folder."""
    found = [*folder.glob("radar_*"), *folder.glob("cluster_*")]
    return [TRUTH, *(path.name for path in found)]


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions, AlphaOptions):
    """Meshes, their position and their alpha."""

    meshes: list[str] | None = argument(
        None,
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1. None "
        "where --motion has a hand.",
        metavar="MESH[:ALPHA]",
    )


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions:
    """Estimator of the received field, and its random numbers."""

    estimator: Estimator | None = option(
        None,
        f"{ESTIMATORS} [default: physical with --material, stochastic with rays or bounces, else "
        "expected]",
    )
    seed: int = option(0, "Same seed, same device: same bits.", metavar="N")


@dataclass(frozen=True, kw_only=True)
class ClusterOptions(WorkerOptions):
    """Which clusters of an array, and on how many workers."""

    clusters: str = option(
        ALL, "Of an --array of clusters those of these numbers, from 1.", metavar=FRAMES_METAVAR
    )


def split_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or Path(text).exists():
        return Path(text), None
    try:
        return Path(name), read_alpha("MESH:ALPHA", number)
    except ValueError:
        return Path(text), None
