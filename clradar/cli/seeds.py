"""Captures of ``clradar simulate`` simulated again, to see how their image varies over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clradar.cli.mesh_scene import load_scene
from clradar.cli.options.materials import MaterialOptions
from clradar.files.failures import fail
from clradar.files.hashing import sha256_of

if TYPE_CHECKING:
    from clradar import Capture, Scene, SimulationSettings, Spread


def simulated_again(
    path: Path, capture: Capture, meshes: Sequence[Path]
) -> tuple[Scene, SimulationSettings, list[Path]]:
    """Scene, settings and mesh files of a capture, from its provenance and the meshes.

    Parameters
    ----------
    path : Path
        Of the capture: meshes that are not given are looked for beside it.
    capture : Capture
    meshes : sequence of Path
        In the order of the simulation; empty for those of the same names.

    Raises
    ------
    MeasurementError
        It is no capture of ``clradar simulate``, or the meshes are not those of the simulation.
    """
    from clradar import SimulationSettings

    meta, options = capture.meta, capture.meta.get("options")
    if meta.get("command") != "simulate" or not isinstance(options, Mapping):
        fail(path, "a capture of `clradar simulate` for --seeds", "one of another origin")
    made = list(options["meshes"])
    files = list(meshes) or [_beside(path, mesh["file"]) for mesh in made]
    if len(files) != len(made):
        fail(path, f"{len(made)} meshes by --mesh", f"{len(files)}")
    known = {record["file"]: record["sha256"] for record in meta["inputs"]}
    for file, mesh in zip(files, made, strict=True):
        if file.is_file() and sha256_of(file) != known[mesh["file"]]:
            fail(file, f"the mesh '{mesh['file']}' that {path} was simulated with", "another file")
    named = [(file, float(mesh["alpha"])) for file, mesh in zip(files, made, strict=True)]
    transform = options["transform"]
    scene = load_scene(
        named, 0.5, dict(options["alpha_of_parts"]), options["unit"],
        None if transform is None else np.array(transform),
    )  # fmt: skip
    scene = _materials(options).on(scene)
    if scene.digest() != meta["scene"]["sha256"]:
        fail(path, "meshes and materials of the simulation", "a scene that differs from it")
    # Captures that do not say it are older than curved facets.
    return scene, SimulationSettings(**{"facets": "flat", **meta["settings"]}), files


def _beside(path: Path, name: str) -> Path:
    for file in (path.absolute().parent / name, Path(name)):
        if file.is_file():
            return file
    fail(path, f"the mesh '{name}' beside it, or by --mesh", "no such file")


def _materials(options: Mapping[str, Any]) -> MaterialOptions:
    files, parts = options.get("materials"), options.get("material_of")
    return MaterialOptions(
        material=options.get("material"),
        material_of=None if parts is None else list(parts),
        materials=None if files is None else [Path(file) for file in files],
    )


def spread_words(found: Spread) -> str:
    """How much varies: the share of power, and amplitude and depth at the maximum."""
    at = np.unravel_index(int(found.amplitude.argmax()), found.amplitude.shape)
    if found.amplitude[at] == 0.0:
        return "the image is zero everywhere"
    relative = 100 * found.amplitude_sd[at] / found.amplitude[at]
    share = f"{100 * found.varying_share:.2g} % of the image's power vary"
    depth = ""
    if found.depth_count[at] > 1:
        millimetres = 1e3 * found.depth_m[at], 1e3 * found.depth_sd_m[at]
        depth = "; depth there {:.1f} mm, deviation {:.2g} mm".format(*millimetres)
    return (
        f"{len(found.seeds)} seeds: {share} ({found.varies}); "
        f"the maximum by {relative:.2g} % of it{depth}"
    )
