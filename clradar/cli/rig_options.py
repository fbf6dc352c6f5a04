"""The options of ``clradar hand`` that are about a rig of one's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from clradar.cli.options import wrong_usage
from clradar.cli.output import print_warning

if TYPE_CHECKING:
    from clradar.hand import HandMesh, HandPose
    from clradar.rigs import Rig


RigOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--rig",
        metavar="HAND",
        help="Pose this hand instead of the embedded one: skinned glTF (.glb, .gltf) or a MANO "
        "model (.pkl, .npz). Its mesh is taken as it is.",
    ),
]
MappingOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--mapping",
        metavar="M.toml",
        help="Which node of the rig is which joint, where it has no WebXR names: a table [joints].",
    ),
]
RigUnitOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--rig-unit",
        metavar="UNIT",
        help="The rig's unit of length: m, cm, mm, inch, or a number of millimetres. "
        "[default: found from the hand's size]",
    ),
]
RigHandOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--rig-hand",
        metavar="SIDE",
        help="Which hand the rig is, right or left, where neither names nor shape say it, or which "
        "of two.",
    ),
]
BetasOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--betas", metavar="B,B,...", help="Shape of a MANO hand, up to 10 numbers."),
]
ThetaOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--theta",
        metavar="THETA.json",
        help="Pose of a MANO hand instead of POSE: a list of 48 numbers, axis times angle, "
        "radians.",
    ),
]


def check_alone(options: Mapping[str, Any]) -> None:
    """Raise if one of the rig's options was given without a rig."""
    for name, value in options.items():
        if value is not None:
            raise wrong_usage(name, "expected together with --rig")


def opened_rig(
    path: Path,
    mapping: Path | None,
    unit: str | None,
    side: str | None,
    betas: str | None,
) -> Rig:
    """Return the rig that the options describe; says which meshes of the file are left out."""
    from clradar.rigs import read_rig

    if side not in (None, "right", "left"):
        raise wrong_usage("--rig-hand", f"expected right or left, got '{side}'")
    rig = read_rig(
        path,
        mapping=mapping,
        unit=None if unit is None else _unit(unit),
        handedness=side,
        betas=None if betas is None else _numbers("--betas", betas),
    )
    for name in rig.ignored:
        print_warning(f"{path}: mesh '{name}' is not moved by the hand and is left out")
    return rig


def posed_rig(rig: Rig, pose: HandPose, theta: Path | None, center_m: Sequence[float]) -> HandMesh:
    """Return the rig's surface in a pose, or at a pose theta in MANO's own parameters."""
    if theta is None:
        return rig.posed(pose, center_m)
    from clradar.rigs import rotations_of_theta

    return rig.turned(rotations_of_theta(rig, read_theta(theta)), center_m)


def read_theta(path: Path) -> list[float]:
    """Return the numbers of a JSON list."""
    from clradar.files.failures import fail
    from clradar.files.json_file import read_json
    from clradar.files.limits import MAX_SMALL_JSON_BYTES

    expected = "a JSON list of 48 numbers"
    values = read_json(path, expected, MAX_SMALL_JSON_BYTES)
    if not isinstance(values, list) or not all(type(v) in (int, float) for v in values):
        fail(path, expected, "something else")
    if len(values) != 48:
        fail(path, expected, f"{len(values)}")
    return values


def described(rig: Rig) -> str:
    """Return what was found out about a rig, for one line."""
    return (
        f"{rig.handedness} hand, unit {1e3 * rig.unit_m:.6g} mm, "
        f"{int(rig.known.sum())} of {len(rig.known)} joints"
    )


def _unit(text: str) -> str | float:
    from clradar.rigs import UNITS_M

    if text in UNITS_M:
        return text
    try:
        value_mm = float(text)
    except ValueError:
        value_mm = 0.0
    if not 0 < value_mm < float("inf"):
        raise wrong_usage(
            "--rig-unit",
            f"expected one of {', '.join(UNITS_M)}, or a positive number of mm, got '{text}'",
        )
    return value_mm / 1e3


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise wrong_usage(option, f"expected numbers, got '{text}'") from None
