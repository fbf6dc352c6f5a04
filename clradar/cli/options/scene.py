"""Options of a simulation: rays, meshes with their alphas and materials, and how they move."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np

import clradar as cl
from clradar.cli.options.common import Amplitude, UnitOptions, WorkerOptions
from clradar.cli.options.groups import argument, option, recorded, wrong_usage
from clradar.cli.parse import ALL, FRAMES_METAVAR, check_unit, numbers
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


PHYSICAL: Final = "physical"

DEFAULT_ALPHA = 0.5

Read = TypeVar("Read")


@dataclass(frozen=True, kw_only=True)
class MaterialOptions:
    """What the meshes are made of."""

    material: str | None = option(
        None,
        "What the meshes are made of, which chooses the physical estimator: a name that "
        "`clradar materials` lists, or one of a file. [default: a perfect conductor]",
        metavar="NAME|FILE.toml:NAME",
        needs="--roughness-mm",
    )
    material_of: list[str] | None = option(
        None,
        "The same of a part; may be repeated: --material palm --material-of thumb=skin.",
        metavar="PART=NAME",
        needs="--roughness-mm",
    )
    materials: list[Path] | None = option(
        None, "Files whose materials have names, too; may be repeated.", metavar="FILE.toml"
    )

    @property
    def given(self) -> bool:
        """Whether a mesh gets a material."""
        return self.material is not None or bool(self.material_of)

    @property
    def material_files(self) -> list[Path]:
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
        named = by_part(
            "--material-of", self.material_of, lambda name: _found("--material-of", name, known)
        )
        for text in self.material_of or []:
            if "=" not in text:
                raise wrong_usage("--material-of", f"expected PART=NAME, got '{text}'")
        parts = known_parts("--material-of", named, scene)
        return scene.with_material(parts) if parts else scene

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


def by_part(
    option: str, texts: Sequence[str] | None, read: Callable[[str], Read]
) -> dict[str | None, Read]:
    """The values of texts ``PART=VALUE``; of None that without a part."""
    found: dict[str | None, Read] = {}
    for text in texts or ():
        name, equals, value = text.rpartition("=")
        part = name if equals else None
        if part in found:
            raise wrong_usage(option, f"part '{part}' is given twice" if equals else "given twice")
        found[part] = read(value)
    return found


def known_parts(option: str, values: Mapping[str | None, Read], scene: cl.Scene) -> dict[str, Read]:
    """The values of named parts, all of which the meshes have to have."""
    named = {part: value for part, value in values.items() if part is not None}
    unknown = sorted(set(named) - set(scene.part_names))
    if unknown:
        raise ModelError(
            f"{option}: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(unknown)}"
        )
    return named


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


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions, MaterialOptions):
    """Meshes, their position, alpha and materials: what a worker process reads, too."""

    meshes: list[str] | None = argument(
        None,
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1. None "
        "where --motion has a hand.",
        metavar="MESH[:ALPHA]",
    )
    alpha: list[str] | None = option(
        None,
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
    )

    @property
    def files(self) -> list[Path]:
        """The files of the meshes, of the transform and of the materials."""
        return [*(path for path, _ in self.named), *super().files, *self.material_files]

    @property
    def alphas(self) -> dict[str | None, float]:
        """The alpha of each named part; of None that of the others."""
        return by_part("--alpha", self.alpha, lambda text: read_alpha("--alpha", text))

    @property
    def default_alpha(self) -> float:
        """The alpha of what has no other."""
        return self.alphas.get(None, DEFAULT_ALPHA)

    @property
    def named(self) -> list[tuple[Path, float]]:
        """The files of the meshes, and the alpha of each."""
        found = [split_alpha(text) for text in self.meshes or []]
        return [(path, self.default_alpha if a is None else a) for path, a in found]

    @property
    def has_alpha(self) -> bool:
        """Whether an alpha was given."""
        return bool(self.alpha) or any(
            split_alpha(text)[1] is not None for text in self.meshes or []
        )

    def load(self) -> cl.Scene:
        """All meshes as one scene."""
        return self.finished(cl.Scene.combine(self.bodies()))

    def bodies(self) -> list[cl.Scene]:
        """The meshes one by one, without the alphas and materials of parts."""
        place = self.matrix()
        return [
            cl.Scene.from_mesh(path, alpha=alpha, unit=self.unit, transform=place)
            for path, alpha in self.named
        ]

    def bodies_by_name(self) -> dict[str, cl.Scene]:
        """The same by the names of their files."""
        names = [path.name for path, _ in self.named]
        if len(set(names)) < len(names):
            raise wrong_usage("MESH", "expected different names of files with --motion")
        return dict(zip(names, self.bodies(), strict=True))

    def record(self) -> dict[str, Any]:
        """The options; files by their content, or by names without folders."""
        place = self.matrix()
        return {
            **recorded(self), "transform": None if place is None else place.tolist(),
            "meshes": [{"file": path.name, "alpha": alpha} for path, alpha in self.named],
        }  # fmt: skip

    def finished(self, scene: cl.Scene) -> cl.Scene:
        """The scene with the alphas of named parts, and of these materials."""
        parts = known_parts("--alpha", self.alphas, scene)
        if parts:
            values = np.array(scene.alpha)
            for name, value in parts.items():
                values[np.asarray(scene.part) == scene.part_names.index(name)] = value
            scene = scene.with_alpha(values)
        return self.on(scene)


def read_alpha(option: str, text: str) -> float:
    """The alpha in the text of an option."""
    values = numbers(text)
    if len(values) != 1:
        raise wrong_usage(option, f"expected a number or PART=number, got '{text}'")
    if not (math.isfinite(values[0]) and 0.0 <= values[0] <= 1.0):
        raise wrong_usage(option, f"expected an alpha in [0, 1], got '{text}'")
    return values[0]


def split_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or len(numbers(number)) != 1 or Path(text).exists():
        return Path(text), None
    return Path(name), read_alpha("MESH:ALPHA", number)


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
        None,
        "Make a recording of so many frames, instead of one capture.",
        metavar="N",
        needs="--motion",
        min=1,
        max=MAX_FRAMES,
    )
    rate_hz: float = option(
        8.0,
        "Frames per second; the first begins at time 0.",
        metavar="HZ",
        needs="--motion",
    )

    def __post_init__(self) -> None:
        if not 0 < self.rate_hz < float("inf"):
            raise wrong_usage("--rate-hz", f"expected a positive number, got {self.rate_hz:g}")


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
