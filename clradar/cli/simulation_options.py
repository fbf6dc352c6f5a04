"""Options of the subcommands that simulate with all settings."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Optional

import typer

from clradar.tracing.settings import RAYS_PER_SAMPLE, RECEPTION_RADIUS_M, SAMPLES_PER_MM2

RECEPTION_RADIUS_MM = 1e3 * RECEPTION_RADIUS_M

START_GHZ, STOP_GHZ, STEPS = 72.0, 82.0, 128


class Normals(str, Enum):
    smooth = "smooth"
    face = "face"


class Amplitude(str, Enum):
    unit = "unit"
    spreading = "spreading"


# Optional and not "| None": typer reads these when Python 3.10 runs, too.
TransformOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--transform",
        metavar="T.json",
        help="4 x 4 matrix, row-major, metres, that moves the meshes into the antenna frame.",
    ),
]
SamplesOption = Annotated[
    Optional[float],  # noqa: UP045
    typer.Option(
        "--samples-per-mm2",
        metavar="N",
        help=f"Surface samples per square millimetre. [default: {SAMPLES_PER_MM2:g}]",
    ),
]
RaysPerFaceOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--rays-per-face", metavar="N", help="Samples on every face, instead of a density."
    ),
]
RaysPerSampleOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--rays-per-sample",
        metavar="N",
        help=f"Rays per sample and Tx. [default: {RAYS_PER_SAMPLE}; 1 with --rays-per-face]",
    ),
]
ReceptionRadiusOption = Annotated[
    float,
    typer.Option(
        "--reception-radius-mm", metavar="MM", help="A ray this near to an Rx is received."
    ),
]
MaxBouncesOption = Annotated[
    int, typer.Option("--max-bounces", metavar="N", help="Reflections per path at most.")
]
NormalsOption = Annotated[
    Normals, typer.Option("--normals", help="Interpolated from the vertices, or the faces'.")
]
CreaseOption = Annotated[
    float,
    typer.Option("--crease-deg", metavar="DEG", help="Edges sharper than this stay sharp."),
]
AmplitudeOption = Annotated[
    Amplitude, typer.Option("--amplitude", help="1 per path, or 1/(R1 R2).")
]
PatternOption = Annotated[
    float,
    typer.Option(
        "--pattern-exponent",
        metavar="P",
        help="With --amplitude spreading: antennas have the pattern cos(angle)^P.",
    ),
]
