"""The folder and the tables of ``clradar fit-hand``."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import clradar as cl
from clradar.cli.comparison import Comparison, simulated_surface
from clradar.cli.console import counted, print_line, print_table, progress_bar
from clradar.cli.outputs import save
from clradar.errors import ClradarWarning
from clradar.files.atomic import write_file
from clradar.files.json_file import write_json

if TYPE_CHECKING:
    from calibration import HandFit

POSE, PLACED, FIT, OVERLAY = "pose.toml", "placed.ply", "fit.json", "overlay.png"
FIGURE, METRICS, CAPTURE, VOLUME = "comparison.png", "metrics.json", "capture.h5", "volume.h5"

FILES = (POSE, PLACED, FIT, OVERLAY, FIGURE, METRICS, CAPTURE, VOLUME)
DIGIT_COLUMNS = (
    "digit",
    "tip x, y, z (mm)",
    "sd (mm)",
    "tip told",
    "angles told",
    "not told: as in the start",
)
BASIN_COLUMNS = ("pose", "start", "hand", "deviance", "tips apart (mm)")


@dataclass(frozen=True, slots=True)
class FittedImages:
    """A fitted hand, its simulation, and before that one of the starting pose, moved rigidly."""

    measured: cl.Volume
    fit: HandFit
    before: cl.Volume
    capture: cl.Capture
    after: cl.Volume

    @classmethod
    def of(
        cls,
        measured: cl.Volume,
        fit: HandFit,
        radar: dict[str, Any],
        seed: int,
        device: cl.Device,
    ) -> FittedImages:
        """Simulate both as `clradar simulate` does; `radar` as in `ImageInput.radar`."""
        from calibration.registration.radar import Radar

        used = Radar.of("fit_hand", radar.get("array"), radar.get("waveform"))

        def imaged(scene: cl.Scene) -> tuple[cl.Capture, cl.Volume]:
            with progress_bar("simulating") as progress:
                capture = cl.simulate(
                    scene, used.array, used.waveform, seed=seed, device=device, progress=progress
                )
            return capture, cl.backproject(capture, measured.grid, check_grid=False, device=device)

        return cls(measured, fit, imaged(fit.started)[1], *imaged(fit.scene))

    def compared(self) -> Comparison:
        """Measured image, before, after."""
        labels = [f"Before: '{self.fit.start}', moved", "After"]
        surface = simulated_surface(self.after.meta)
        if surface is not None:
            labels[1] += f", {surface}"
        with warnings.catch_warnings():
            # That the start is another pose is no news; the table has what differs.
            warnings.simplefilter("ignore", ClradarWarning)
            return Comparison.of([self.measured, self.before, self.after], labels)


def write_fit(folder: Path, images: FittedImages, source: str, origin: dict[str, Any]) -> None:
    """Write all files of a fit into `folder`."""
    from calibration.hand_fit.figure import hand_fit_figure
    from clradar.files.meshes.ply_parts import ply_of_parts
    from clradar.hand import write_pose
    from clradar.plot import save_figure

    fit, scene = images.fit, images.fit.scene
    name = f"{fit.pose.name}, fitted to {Path(source).name}"
    write_pose(folder / POSE, replace(fit.pose, name=name, description="", source=source))
    placed = ply_of_parts(
        scene.vertices_m, scene.faces, np.asarray(scene.part), scene.part_names, scene.texture_m
    )
    write_file(folder / PLACED, placed, force=False)
    write_json(folder / FIT, {**fit.to_dict(), **origin}, force=False)
    with progress_bar("drawing"):
        save_figure(hand_fit_figure(images.measured, fit), folder / OVERLAY)
    compared = images.compared()
    compared.save_figure(folder / FIGURE, force=False, differences=True)
    before, after = (found.to_dict() for found in compared.metrics)
    metrics = {"measured": source, "before": before, "after": after, **origin}
    write_json(folder / METRICS, metrics, force=False)
    save(folder / CAPTURE, images.capture, origin, force=False)
    save(folder / VOLUME, images.after, origin, force=False)
    compared.print()


def print_fit(fit: HandFit) -> None:
    """Print tips, told angles and basins as tables, and what remains of the report."""
    print_table(DIGIT_COLUMNS, digit_rows(fit), right=DIGIT_COLUMNS[1:3])
    if len(fit.basins) > 1:
        print_table(BASIN_COLUMNS, basin_rows(fit), right=BASIN_COLUMNS[3:])
    print_line(fit.summary())
    if fit.remarks():
        print_line(f"Doubtful: see the {counted(len(fit.remarks()), 'warning')} above.")


def digit_rows(fit: HandFit) -> list[list[str]]:
    """One row for each digit, and one for the arch of the palm."""
    from calibration.hand_fit.hand_state import ANGLES_OF_DIGIT
    from calibration.hand_fit.result import ANGLE_NAMES, DIGITS

    rows = []
    for digit, angles in ANGLES_OF_DIGIT.items():
        names = ANGLE_NAMES[angles]
        untold = [short_name(name, digit) for name in names if name in fit.untold]
        where = ["", "", ""]
        if digit in DIGITS:
            number = DIGITS.index(digit)
            at_m, std_m = fit.tips_m[number], fit.tip_std_m[number]
            if np.isfinite(at_m).all():
                place = ", ".join(f"{1e3 * v:.1f}" for v in at_m)
                where = [place, f"{1e3 * std_m:.1f}", "yes" if fit.told_tips[number] else "no"]
        told = f"{np.count_nonzero(fit.told_angles[angles])} of {len(names)}"
        rows.append([digit, *where, told, ", ".join(untold)])
    return rows


def short_name(angle: str, digit: str) -> str:
    """The name of an angle in the row of its digit: "phalanx-distal flexion"."""
    for prefix in (f"{digit}-finger-", f"{digit}-"):
        angle = angle.removeprefix(prefix)
    return angle


def basin_rows(fit: HandFit) -> list[list[str]]:
    """One row for each pose in which the fit came to rest, with the tips' largest distance."""
    return [
        [
            str(number),
            basin.start,
            basin.handedness,
            f"{basin.deviance:.1f}",
            f"{1e3 * fit.tips_apart_m(basin).max():.0f}",
        ]
        for number, basin in enumerate(fit.basins, start=1)
    ]
