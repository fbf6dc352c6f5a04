"""Compared images and their metrics, and the figure of what a file holds."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import clradar as cl
import measurement_io
from clradar.cli.console import print_line, print_table, progress_bar
from clradar.cli.groups import wrong_usage
from clradar.cli.inputs import nothing_to_draw, title_of
from clradar.cli.outputs import write
from clradar.compare.metrics import METRIC_TABLE
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import warn
from clradar.files.atomic import write_file
from clradar.model.volume import capture_meta

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIMULATION_FILES = ("placed.ply", "capture.h5", "volume.h5", "comparison.png", "metrics.json")
"""What is written of a mesh or a hand that was fitted and simulated."""


def simulated_surface(meta: Mapping[str, Any]) -> str | None:
    """What was simulated: the one alpha, or the materials if physical; None if there is neither."""
    scene = capture_meta(meta).get("scene")
    if not isinstance(scene, Mapping):
        return None
    materials = scene.get("materials")  # of the physical estimator, which does not use alpha
    if isinstance(materials, Sequence):
        names = [m.get("name") for m in materials if isinstance(m, Mapping)]
        return " and ".join(str(name) for name in names) or None
    low, high = scene.get("alpha_min"), scene.get("alpha_max")
    if not isinstance(low, int | float) or low != high:
        return None
    return f"\N{GREEK SMALL LETTER ALPHA} = {low:.3g}"


def figure_labels(paths: Sequence[Path], metas: Sequence[Mapping[str, Any]]) -> list[str]:
    """A short label for each image: its surface if no other image has it, else its name."""
    surfaces = [simulated_surface(meta) for meta in metas]
    labels = []
    for path, surface, meta in zip(paths, surfaces, metas, strict=True):
        if surface is None or surfaces.count(surface) > 1:
            surface = title_of(path, meta) if path.is_dir() else path.stem or str(path)
        labels.append(surface)
    # Files of the same name in different folders: the whole path tells them apart.
    named = zip(paths, labels, strict=True)
    return [str(path) if labels.count(label) > 1 else label for path, label in named]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A measured image and simulated ones, with the metrics of each."""

    maps: Sequence[cl.DepthMap]
    labels: Sequence[str]
    metrics: Sequence[cl.Metrics]
    dynamic_range_db: float

    @classmethod
    def of(
        cls,
        volumes: Sequence[cl.Volume],
        labels: Sequence[str],
        dynamic_range_db: float = DYNAMIC_RANGE_DB,
    ) -> Comparison:
        """Compare the first volume with each of the labelled ones after it."""
        maps = [volume.depth_map(dynamic_range_db) for volume in volumes]
        metrics = [cl.compare(maps[0], m, dynamic_range_db=dynamic_range_db) for m in maps[1:]]
        return cls(maps, labels, metrics, dynamic_range_db)

    def print(self) -> None:
        """Print one row of metrics per simulated image, and what they do not show."""
        labelled = list(zip(self.labels, self.metrics, strict=True))
        names = [one.name for one in METRIC_TABLE]
        rows = [[label, *(one.text(found) for one in METRIC_TABLE)] for label, found in labelled]
        print_table(("simulated", *names), rows, right=names)
        for label, found in labelled:
            for remark in found.remarks:
                print_line(f"{label}: {remark}")

    def figure(self, **options: Any) -> Figure:
        """All images side by side; `options` as in `clradar.plot.comparison_figure`."""
        columns = list(zip(self.labels, self.maps[1:], strict=True))
        return cl.plot.comparison_figure(
            self.maps[0], columns, metrics=self.metrics, dynamic_range_db=self.dynamic_range_db,
            **options,
        )  # fmt: skip

    def records(self, paths: Sequence[Path]) -> list[dict[str, Any]]:
        """One JSON object for each simulated image, which is in the file of the same position."""
        return [
            {"file": str(path), "label": label, "metrics": found.to_dict()}
            for path, label, found in zip(paths, self.labels, self.metrics, strict=True)
        ]


def write_simulation(
    folder: Path,
    measured: Path,
    simulated: tuple[cl.Scene, cl.Capture, cl.Volume],
    compared: Comparison,
    metrics: Mapping[str, Any],
    **more: Any,
) -> None:
    """Write a placed mesh, its simulation, and both compared with the measurement."""
    contents = (
        *simulated, partial(compared.figure, differences=True),
        {"measured": str(measured), **metrics},
    )  # fmt: skip
    for name, content in zip(SIMULATION_FILES, contents, strict=True):
        write(folder / name, content, **more)
    compared.print()


def figure_of(
    path: Path, *, view: str | None = None, plane: tuple[str, float | None] | None = None
) -> Figure | None:
    """The image of a volume in a `view` or a `plane` (axis, mm); echoes, or gains, of the others.

    None, and a warning, where there is nothing to see.
    """
    found = measurement_io.open(path)
    if isinstance(found, cl.Volume):
        if (reason := nothing_to_draw(found)) is not None:
            warn(f"{path}: not drawn, since the image is {reason}")
            return None
        return volume_figure(found, title_of(path, found.meta), plane, view=view)
    for name, value in {"--view": view, "--slice": plane}.items():
        if value is not None:
            raise wrong_usage(name, f"expected with a volume, which {path} is not")
    if isinstance(found, measurement_io.Recording):
        title = title_of(path, {})
        with progress_bar("reading") as progress:
            return cl.plot.recording_figure(found, found.frame_numbers, title, progress=progress)
    if isinstance(found, cl.ChannelCalibration):
        from calibration.channels.figure import channels_figure

        return channels_figure(found, title_of(path, found.meta))
    return cl.plot.capture_figure(found, title_of(path, found.meta))


def volume_figure(
    image: cl.Volume | cl.DepthMap,
    title: str,
    plane: tuple[str, float | None] | None,
    **shown: Any,
) -> Figure:
    """The figure of an image, or of one plane of a volume."""
    if plane is not None and isinstance(image, cl.Volume):
        axis, place_mm = plane
        image = cl.plot.plane_of(image, axis, None if place_mm is None else place_mm / 1e3)
    return cl.plot.image_figure(image, title, **shown)


def write_csv(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    write_file(path, text.getvalue().encode(), force=True)
