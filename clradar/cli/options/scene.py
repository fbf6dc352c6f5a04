"""Options of what is simulated or fitted: meshes and hands, what they are made of, rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

import clradar as cl
import measurement_io
from clradar.cli import parse
from clradar.cli.groups import argument, arguments_of, option, wrong_usage
from clradar.cli.options.measured import SearchOptions, UnitOptions, own_option, rig_option
from clradar.constants import PLAUSIBLE_RADIUS_M
from clradar.errors import ModelError, warn
from clradar.geometry.normals import CREASE_DEG
from clradar.model import checks
from clradar.model.known_materials import KNOWN
from clradar.tracing.settings import EXPECTED_SAMPLES_PER_MM2, RAYS_PER_SAMPLE, SAMPLES_PER_MM2
from clradar.tracing.suited import RECEPTION_RADIUS_M

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
    samples_per_mm2: float | None = option(
        f"Surface samples per mm^2. [default: {SAMPLES_PER_MM2:g} if stochastic]",
        panel="Expert",
    )
    rays_per_sample: int | None = option(
        f"Rays per sample and Tx. [default: {RAYS_PER_SAMPLE}; 1 if samples are given per face]",
        panel="Expert",
    )


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(SamplingOptions):
    """How rays are launched, reflected and received."""

    PANEL = "Expert"

    rays_per_face: int | None = option("Samples on every face, not a density.")
    reception_radius_mm: float | None = option(
        f"A ray this near to an Rx is received. [default: {1e3 * RECEPTION_RADIUS_M:g}; of random "
        "rays what suits range and frequency]",
        check=partial(parse.check_unit, what="a radius", bounds=PLAUSIBLE_RADIUS_M, unit="mm"),
    )
    max_bounces: int = option("Reflections per path at most.", 1)
    normals: Literal["smooth", "face"] = option("Of the vertices, or the faces.", "smooth")
    crease_deg: float = option("Edges sharper than this stay sharp.", CREASE_DEG)
    facets: Literal["curved", "flat"] = option(
        "Paths end on the surface of the normals, or on the flat faces.", "curved"
    )

    def settings(self, **more: Any) -> cl.SimulationSettings:
        """The settings of the simulation; `more` are seed and estimator."""
        return cl.SimulationSettings(**arguments_of(self), **more)


@dataclass(frozen=True, kw_only=True)
class PlacementOptions(UnitOptions):
    transform: Path | None = option(
        "4 x 4 matrix, row-major, metres, that moves the meshes into the antenna frame; or the "
        "alignment.json of a recording.",
        metavar="T.json",
        needs="--mesh",
    )

    def matrix(self) -> np.ndarray | None:
        return None if self.transform is None else measurement_io.read_transform(self.transform)


def _split(option: str, text: str) -> tuple[Path | None, str]:
    """File and name of ``FILE.toml:NAME``; no file in front of a plain name."""
    from clradar.model.material_file import SUFFIXES

    file, colon, name = text.rpartition(":")
    return (Path(file), name) if colon and file.lower().endswith(SUFFIXES) else (None, text)


def _of_parts(option: str, texts: list[str]) -> dict[Any, tuple[Path | None, str]]:
    for text in (text for text in texts if "=" not in text):
        raise wrong_usage(option, f"expected PART=NAME, got '{text}'")
    return parse.by_part(option, texts, _split)


def _material(option: str, file: Path | None, name: str) -> cl.Material:
    known = KNOWN if file is None else cl.read_materials(file)
    if name not in known:
        where = " or FILE.toml:NAME" if file is None else f" of {file}"
        raise wrong_usage(option, f"expected one of {', '.join(known)}{where}, got '{name}'")
    return known[name]


def check_parts(option: str, parts: Mapping[Any, Any] | None, scene: cl.Scene) -> None:
    if unknown := {*(parts or ())} - {None, *scene.part_names}:
        raise ModelError(
            f"{option}: expected parts of the meshes ({', '.join(scene.part_names)}), got "
            f"{', '.join(sorted(map(str, unknown)))}"
        )


@dataclass(frozen=True, kw_only=True)
class MaterialOptions:
    material: tuple[Path | None, str] | None = option(
        "What the meshes are made of, for the physical estimator: a name of `clradar materials`, "
        "or one of a file. [default: a perfect conductor]",
        metavar="NAME|FILE.toml:NAME",
        needs="--roughness-mm",
        parse=_split,
    )
    material_of: dict[str, tuple[Path | None, str]] | None = option(
        "The same of a part; may be repeated: --material palm --material-of thumb=skin.",
        metavar="PART=NAME",
        needs="--roughness-mm",
        parse=_of_parts,
        text=list[str],
    )

    def estimator(self, chosen: Estimator | None) -> Estimator | None:
        """The `chosen` estimator, or with a material the one that knows materials."""
        if (self.material is None and not self.material_of) or chosen == PHYSICAL:
            return chosen
        if chosen is None:
            return PHYSICAL
        warn(f"--material: not used by --estimator {chosen}; {PHYSICAL} knows materials")
        return chosen

    def on(self, scene: cl.Scene) -> cl.Scene:
        if self.material is not None:
            scene = scene.with_material(_material("--material", *self.material))
        name = "--material-of"
        parts = {n: _material(name, *one) for n, one in (self.material_of or {}).items()}
        check_parts(name, parts, scene)
        return scene.with_material(parts) if parts else scene


def mesh_and_alpha(text: str) -> tuple[Path, float | None]:
    """File and alpha of ``MESH[:ALPHA]``; what follows the last colon has to be a number."""
    name, colon, number = text.rpartition(":")
    if not colon or not name or len(parse.numbers(number)) != 1 or Path(text).exists():
        return Path(text), None
    return Path(name), parse.alpha_of("MESH:ALPHA", number)


Meshes = list[tuple[Path, float | None]]


@dataclass(frozen=True, kw_only=True)
class SceneOptions(PlacementOptions, MaterialOptions):
    """Meshes, their position, alpha and materials."""

    meshes: Meshes | None = argument(
        "Mesh files, each with an alpha of its own if it differs: hand.ply table.stl:0.1. None "
        "where --motion has a hand.",
        metavar="MESH[:ALPHA]",
        parse=lambda _, texts: list(map(mesh_and_alpha, texts)),
        text=list[str],
    )
    alpha: dict[str | None, float] | None = option(
        "0 specular to 1 diffuse; may be repeated for named parts: --alpha palm=0.6. "
        f"[default: {DEFAULT_ALPHA:g}]",
        metavar="ALPHA|PART=ALPHA",
        parse=partial(parse.by_part, read=parse.alpha_of),
        text=list[str],
    )

    @property
    def default_alpha(self) -> float:
        return (self.alpha or {}).get(None, DEFAULT_ALPHA)

    def load(self) -> cl.Scene:
        return self.finished(cl.Scene.combine(self.bodies()))

    def bodies(self) -> list[cl.Scene]:
        """The meshes one by one, without the alphas and materials of parts."""
        place = self.matrix()
        return [
            cl.Scene.from_mesh(
                path, alpha=self.default_alpha if alpha is None else alpha, unit=self.unit,
                transform=place,
            )
            for path, alpha in self.meshes or []
        ]  # fmt: skip

    def finished(self, scene: cl.Scene) -> cl.Scene:
        """The scene with the alphas of named parts, and of these materials."""
        check_parts("--alpha", self.alpha, scene)
        parts = {name: value for name, value in (self.alpha or {}).items() if name is not None}
        if parts:
            values = np.array(scene.alpha)
            for name, value in parts.items():
                values[np.asarray(scene.part) == scene.part_names.index(name)] = value
            scene = scene.with_alpha(values)
        return self.on(scene)


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Size and proportions of the embedded hand."""

    length_mm: float | None = own_option("Wrist crease to middle fingertip. [default: 187.4]")
    breadth_mm: float | None = own_option("Across the knuckles. [default: 85.6]")
    finger_lengths: tuple[float, float, float, float, float] | None = own_option(
        "Thumb to little finger, relative to an average hand of this length.", metavar="T I M R P"
    )
    girth: float | None = own_option("Thickness, relative to an average hand of this breadth.")

    @property
    def shape(self) -> cl.hand.HandShape | None:
        """Length, breadth, finger lengths, girth, if there is one of them."""
        known = arguments_of(self, ShapeOptions)
        return cl.hand.HandShape(**known) if known else None


def _unit_of_rig(option: str, text: str) -> str | float:
    if text in cl.rigs.UNITS_M:
        return text
    values_mm = parse.numbers(text)
    if len(values_mm) != 1 or values_mm[0] <= 0:
        known = f"one of {', '.join(cl.rigs.UNITS_M)}, or a positive number of mm"
        raise wrong_usage(option, f"expected {known}, got '{text}'")
    return values_mm[0]


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    rig: Path | None = option(
        "Pose this hand instead: skinned glTF (.glb, .gltf) or a MANO model (.pkl, .npz).",
        metavar="HAND",
        needs="--fit-hand",
    )
    mapping: Path | None = rig_option(
        "Which node is which joint, without WebXR names: a table [joints].", metavar="M.toml"
    )
    rig_unit: str | float | None = rig_option(
        "m, cm, mm, inch, or a number of mm. [default: m]",
        metavar="UNIT",
        parse=_unit_of_rig,
    )
    rig_hand: Literal["right", "left"] | None = rig_option(
        "Which hand the rig is. [default: as its names say, else right]"
    )
    betas: tuple[float, ...] | None = rig_option(
        "Shape of a MANO hand, up to 10 numbers.",
        metavar="B,B,...",
        parse=parse.some,
    )

    def read_rig(self) -> cl.rigs.Rig:
        assert self.rig is not None
        unit = self.rig_unit / 1e3 if isinstance(self.rig_unit, float) else self.rig_unit
        return cl.rigs.read_rig(
            self.rig, mapping=self.mapping, unit=unit, handedness=self.rig_hand, betas=self.betas
        )


@dataclass(frozen=True, kw_only=True)
class HandOptions(ShapeOptions, RigOptions, SearchOptions):
    """What is known of the hand that is fitted to one image or to frames."""

    hand: Literal["right", "left", "either"] | None = own_option(
        "Which hand it is. [default: right; that of an earlier fit, or of the rig]"
    )
    fit_shape: bool = own_option("Fit size and proportions of the hand, too.", False)
    angle_std_deg: float = option(
        "Standard deviation of flexion from the starting pose.",
        12.0,
        needs="--fit-hand",
        check=checks.positive,
    )
    seed: int = option("Of all that is drawn.", 0, needs="--fit-hand")

    def settings(self, text: str) -> dict[str, Any]:
        """The arguments that `calibration.fit_hand` and `calibration.fit_hands` have both."""
        from calibration.hand_fit.starts import starts_of

        starts = starts_of([one for one, _ in starts_in(text)])
        for start in starts:  # an earlier fit has to be of the hand that was given
            if self.hand is not None and start.handedness not in (None, self.hand):
                expected = f"expected {start.handedness}, as in --pose, got '{self.hand}'"
                raise wrong_usage("--hand", expected)
        names = ("fit_shape", "angle_std_deg", "search_deg", "seed")
        settings = {"pose": starts, **{n: getattr(self, n) for n in names}}
        if self.rig is None:
            return {**settings, "handedness": self.hand or "right", "shape": self.shape}
        rig = self.read_rig()
        return {**settings, "rig": rig, "handedness": rig.handedness}


def starts_in(text: str) -> list[tuple[str, Path | None]]:
    """Starts of a fit, poses and files with commas between them; each with its file, if it is one.

    A comma in the name of a file that exists separates nothing.
    """
    from calibration.hand_fit.starts import start_file

    texts = [text] if Path(text).exists() else text.split(",")
    return [(one, start_file(one)) for one in texts]


def start_files(text: str) -> list[Path]:
    return [path for _, path in starts_in(text) if path is not None]
