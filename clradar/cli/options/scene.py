"""Options of a simulation: rays, meshes with their alphas and materials, and how they move."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import numpy as np

import clradar as cl
from clradar.cli.options.common import UnitOptions
from clradar.cli.options.groups import argument, option, recorded, wrong_usage
from clradar.cli.parse import alpha_of, check_unit, numbers
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
    from clradar.motion.motion_record import Motion

Estimator = Literal["stochastic", "expected", "physical"]

PHYSICAL: Final = "physical"

DEFAULT_ALPHA = 0.5

ESTIMATORS = (
    "stochastic: random rays, as in the paper; expected: their mean, without shot noise, from "
    f"{EXPECTED_SAMPLES_PER_MM2:g} sample per mm^2; physical: S-parameters of the materials, "
    "without alpha."
)


@dataclass(frozen=True, kw_only=True)
class SamplingOptions:
    """How densely rays are launched."""

    samples_per_mm2: float | None = option(
        f"Surface samples per mm^2. [default: {SAMPLES_PER_MM2:g} if stochastic]",
        metavar="N",
        panel="Expert",
    )
    rays_per_sample: int | None = option(
        f"Rays per sample and Tx. [default: {RAYS_PER_SAMPLE}; 1 if samples are given per face]",
        metavar="N",
        panel="Expert",
    )


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(SamplingOptions):
    """How rays are launched, reflected and received."""

    PANEL = "Expert"

    rays_per_face: int | None = option("Samples on every face, not a density.", metavar="N")
    reception_radius_mm: float | None = option(
        f"A ray this near to an Rx is received. [default: {1e3 * RECEPTION_RADIUS_M:g}; of random "
        "rays what suits range and frequency]"
    )
    max_bounces: int = option("Reflections per path at most.", 1, metavar="N")
    normals: Literal["smooth", "face"] = option("Of the vertices, or the faces.", "smooth")
    crease_deg: float = option("Edges sharper than this stay sharp.", CREASE_DEG)
    facets: Literal["curved", "flat"] = option(
        "Paths end on the surface of the normals, or on the flat faces.", "curved"
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
        "4 x 4 matrix, row-major, metres, that moves the meshes into the antenna frame; or the "
        "alignment.json of a recording.",
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


Read = TypeVar("Read")


@dataclass(frozen=True, kw_only=True)
class MaterialOptions:
    """What the meshes are made of."""

    material: str | None = option(
        "What the meshes are made of, for the physical estimator: a name of `clradar materials`, "
        "or one of a file. [default: a perfect conductor]",
        metavar="NAME|FILE.toml:NAME",
        needs="--roughness-mm",
    )
    material_of: list[str] | None = option(
        "The same of a part; may be repeated: --material palm --material-of thumb=skin.",
        metavar="PART=NAME",
        needs="--roughness-mm",
    )

    @property
    def given(self) -> bool:
        """Whether a mesh gets a material."""
        return self.material is not None or bool(self.material_of)

    @property
    def material_files(self) -> list[Path]:
        """The files that are read, each once."""
        texts = [self.material, *(text.rpartition("=")[2] for text in self.material_of or [])]
        files = [_split(text)[0] for text in texts if text is not None]
        return list(dict.fromkeys(file for file in files if file is not None))

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
        if self.material is not None:
            scene = scene.with_material(_material("--material", self.material))
        parts = by_part("--material-of", self.material_of, _material, scene)
        if None in parts:
            text = next(text for text in self.material_of or () if "=" not in text)
            raise wrong_usage("--material-of", f"expected PART=NAME, got '{text}'")
        return scene.with_material(parts) if parts else scene


def by_part(
    option: str,
    texts: Sequence[str] | None,
    read: Callable[[str, str], Read],
    scene: cl.Scene | None = None,
) -> dict[Any, Read]:
    """The values of texts ``PART=VALUE``, of None that without a part; a scene has all parts."""
    values: dict[Any, Read] = {}
    for text in texts or ():
        name, equals, value = text.rpartition("=")
        part = name if equals else None
        if part in values:
            raise wrong_usage(option, f"part '{part}' is given twice" if equals else "given twice")
        values[part] = read(option, value)
    if scene is not None and (unknown := {*values} - {None, *scene.part_names}):
        raise ModelError(
            f"{option}: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(sorted(map(str, unknown)))}"
        )
    return values


def _split(text: str) -> tuple[Path | None, str]:
    """File and name of ``FILE.toml:NAME``; no file in front of a plain name."""
    from clradar.model.material_file import SUFFIXES

    file, colon, name = text.rpartition(":")
    return (Path(file), name) if colon and file.lower().endswith(SUFFIXES) else (None, text)


def _material(option: str, text: str) -> cl.Material:
    from clradar.model.known_materials import KNOWN

    file, name = _split(text)
    known = KNOWN if file is None else cl.read_materials(file)
    if name not in known:
        where = " or FILE.toml:NAME" if file is None else f" of {file}"
        raise wrong_usage(option, f"expected one of {', '.join(known)}{where}, got '{name}'")
    return known[name]


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions, MaterialOptions):
    """Meshes, their position, alpha and materials: what a worker process reads, too."""

    meshes: list[str] | None = argument(
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1. None "
        "where --motion has a hand.",
        metavar="MESH[:ALPHA]",
    )
    alpha: list[str] | None = option(
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
    )

    @property
    def files(self) -> list[Path]:
        """The files of the meshes, of the transform and of the materials."""
        return [*(path for path, _ in self.named), *super().files, *self.material_files]

    @property
    def default_alpha(self) -> float:
        """The alpha of what has no other."""
        return by_part("--alpha", self.alpha, read_alpha).get(None, DEFAULT_ALPHA)

    @property
    def named(self) -> list[tuple[Path, float]]:
        """The files of the meshes, and the alpha of each."""
        found = [split_alpha(text) for text in self.meshes or []]
        return [(path, self.default_alpha if a is None else a) for path, a in found]

    @property
    def has_alpha(self) -> bool:
        """Whether an alpha was given."""
        own = (split_alpha(text)[1] for text in self.meshes or [])
        return bool(self.alpha) or any(alpha is not None for alpha in own)

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
        parts = by_part("--alpha", self.alpha, read_alpha, scene)
        if {*parts} - {None}:
            values = np.array(scene.alpha)
            for name, value in parts.items():
                if name is not None:
                    values[np.asarray(scene.part) == scene.part_names.index(name)] = value
            scene = scene.with_alpha(values)
        return self.on(scene)


def read_alpha(option: str, text: str) -> float:
    """The alpha in the text of an option."""
    return alpha_of(option, text, "PART=number")


def split_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or len(numbers(number)) != 1 or Path(text).exists():
        return Path(text), None
    return Path(name), read_alpha("MESH:ALPHA", number)


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Movement, and frames of it."""

    motion: Path | None = option(
        "How meshes and hands move, and when each sample is recorded (docs/movement.md).",
        metavar="MOTION.toml",
    )
    frames: int | None = option(
        "Make a recording of so many frames.", metavar="N", needs="--motion", min=1, max=10_000
    )
    rate_hz: float = option("Frames per second, from time 0 on.", 8.0, needs="--motion")

    def __post_init__(self) -> None:
        if not 0 < self.rate_hz < float("inf"):
            raise wrong_usage("--rate-hz", f"expected a positive number, got {self.rate_hz:g}")

    def read(self) -> Motion | None:
        """The movement of the file, if there is one."""
        from clradar.motion.motion_file import read_motion

        return None if self.motion is None else read_motion(self.motion)


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions:
    """Estimator of the received field, and its random numbers."""

    estimator: Estimator | None = option(
        f"{ESTIMATORS} [default: physical with --material, stochastic with rays or bounces, else "
        "expected]",
    )
    seed: int = option("Same seed, same device: same bits.", 0, metavar="N")
