"""Self-contained HTML report: figure, 3-D view, metrics and settings in one file."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

from clradar.compare import Metrics, compare, depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.plot import comparison_figure, image_figure, png_bytes
from clradar.plot.views import FRONT, rcs_image, view_of
from clradar.report.tables import escaped, image_facts, metrics_section, settings_table
from clradar.report.template import details, filled
from clradar.report.view_data import Cloud, clouds, panel_places, slice_data, view_data

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_DPI = 200
"""Resolution of the figure: sharp at twice the width that it has on a wide screen."""

SHOWN_FIRST = 2
"""Clouds in the 3-D view when the page opens: the measurement and the first simulation."""

COMPARISON_HINT = """Amplitude above depth, in the radar's view: x increases to the left. Each
image is relative to its own maximum; the background is more than {dynamic_range}&nbsp;dB below it.
The lowest row shows where measurement and simulation disagree: orange is stronger in the
measurement than all of the simulation nearby, blue the other way round; a ring surrounds an object
that is missing from the simulation, a dotted ring one in the simulation alone."""

IMAGE_HINT = """Amplitude and depth; x increases to the left, as the radar sees it. The background
is more than {dynamic_range}&nbsp;dB below the maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportImage:
    """An image of a report, with its label and provenance.

    Parameters
    ----------
    label : str
        Its name in figure, tables and view: plain text.
    image : Volume or DepthMap
    source : str
        Its origin, such as a file's name: plain text.
    meta : mapping, optional
        Settings and provenance, in types of JSON. None: the volume's own `meta`; a depth map has
        none.

    Examples
    --------
    >>> import clradar
    >>> from clradar.report import ReportImage
    >>> grid = clradar.VoxelGrid([0, 0, 0.3], [1e-3] * 3, (2, 1, 1))
    >>> entry = ReportImage("alpha = 0.3", clradar.Volume([[[1, 0.5]]], grid, {"kind": "image"}))
    >>> entry.label, dict(entry.image.meta)
    ('alpha = 0.3', {'kind': 'image'})
    """

    label: str
    image: Volume | DepthMap
    source: str = ""
    meta: Mapping[str, Any] | None = None


def html_report(
    measured: ReportImage,
    simulated: Sequence[ReportImage],
    *,
    metrics: Sequence[Metrics] | None = None,
    title: str = "Measurement against simulation",
    notes: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
) -> str:
    """Return a self-contained HTML page that compares simulated images with a measured one.

    Parameters
    ----------
    measured : ReportImage
    simulated : sequence of ReportImage
        At least one, each on the pixels of the measured one.
    metrics : sequence of Metrics, optional
        One for each simulated image. None computes them with `clradar.compare`.
    title : str
        Plain text.
    notes : sequence of str
        Paragraphs of plain text below the title; line feeds are kept.
    settings : mapping, optional
        Settings of the comparison, in types of JSON.
    dynamic_range_db : float, decibel
        Pixels further below an image's own maximum are background.

    Returns
    -------
    str
        To be written as UTF-8. The same arguments give the same text. It loads nothing: style,
        script, figure and points are inside, and a content security policy forbids anything else.

    Raises
    ------
    CompareError
        No simulated image; another number of metrics, or metrics at another dynamic range; the
        errors of `clradar.compare`.
    ModelError
        `dynamic_range_db` is not a positive number.

    Notes
    -----
    Labels, sources, notes and settings can come from untrusted files: all of it is escaped, and the
    policy allows the page's own script alone, identified by its hash.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.report import ReportImage, html_report
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> near, far = (clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m) for z_m in (0.300, 0.302))
    >>> page = html_report(ReportImage("measured", near), [ReportImage("alpha = 0.3", far)])
    >>> "overlap" in page, "0.779" in page
    (True, True)
    >>> _ = Path("report.html").write_text(page, encoding="utf-8")
    """
    dynamic_range_db = checks.dynamic_range("html_report: dynamic_range_db", dynamic_range_db)
    if not simulated:
        raise CompareError("html_report: expected at least one simulated image, got none")
    inputs = [measured, *simulated]
    maps = [depth_map_of(i.image, dynamic_range_db, f"image '{i.label}'") for i in inputs]
    if metrics is None:
        metrics = [compare(maps[0], m, dynamic_range_db=dynamic_range_db) for m in maps[1:]]
    if len(metrics) != len(simulated):
        raise CompareError(
            f"html_report: expected metrics for {len(simulated)} simulated images, "
            f"got {len(metrics)}"
        )
    labels = [i.label for i in simulated]
    figure = comparison_figure(
        maps[0],
        list(zip(labels, maps[1:], strict=True)),
        metrics=metrics,
        measured_label=measured.label,
        dynamic_range_db=dynamic_range_db,
        differences=True,
    )
    return _page(
        title,
        inputs,
        maps,
        figure,
        panels=panel_places(figure, maps),
        figure_text=f"Amplitude above depth, in a row: {measured.label}; {'; '.join(labels)}",
        hint=COMPARISON_HINT,
        result=metrics_section(labels, metrics),
        notes=notes,
        settings=settings,
        settings_of="This comparison",
    )


def image_report(
    image: ReportImage,
    *,
    title: str | None = None,
    notes: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    dynamic_range_db: float = DYNAMIC_RANGE_DB,
    view: str | None = None,
    dbsm: bool = False,
) -> str:
    """Return a self-contained HTML page of one image.

    Parameters
    ----------
    image : ReportImage
    title : str, optional
        Plain text; the image's label if not given.
    notes, settings
        As in `html_report`.
    dynamic_range_db : float, decibel
        Pixels further below the maximum are background.
    view : "xy", "xz", "yz" or "all", optional
        Axes of the figure, as in `clradar.plot.image_figure`.
    dbsm : bool
        Levels as radar cross sections, as in `clradar.plot.image_figure`.

    Returns
    -------
    str
        As `html_report` returns it, with figure, 3-D view, facts, settings and provenance.

    Raises
    ------
    CompareError
        The image is zero everywhere, without any depth, a single voxel, or a depth map that was cut
        at a smaller dynamic range.
    ModelError
        `dynamic_range_db` is not a positive number, or the view is unknown; `dbsm` of an image that
        is not on an absolute scale.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.report import ReportImage, image_report
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> page = image_report(ReportImage("spot", clradar.DepthMap(0 * spot + 0.3, spot, x_m, x_m)))
    >>> "at x = 0.0, y = 0.0, z = 300.0 mm" in page
    True
    """
    dynamic_range_db = checks.dynamic_range("image_report: dynamic_range_db", dynamic_range_db)
    content = rcs_image(image.image) if dbsm else image.image
    shown = depth_map_of(content, dynamic_range_db, f"image '{image.label}'")
    figure = image_figure(image.image, dynamic_range_db=dynamic_range_db, view=view, dbsm=dbsm)
    front = view != "all" and len(figure.axes) == 4 and view_of(image.image, view) is FRONT
    facts = settings_table(image_facts(content, shown, image.source, dbsm=dbsm))
    return _page(
        image.label if title is None else title,
        [image],
        [shown],
        figure,
        panels=panel_places(figure, [shown]) if front else [],
        figure_text=f"Amplitude and depth: {image.label}",
        hint=IMAGE_HINT,
        result=f"<section><h2>Facts</h2>{facts}</section>",
        notes=notes,
        settings=settings,
        settings_of="This page",
    )


def _page(
    title: str,
    inputs: Sequence[ReportImage],
    maps: Sequence[DepthMap],
    figure: Figure,
    *,
    panels: list[dict[str, Any]],
    figure_text: str,
    hint: str,
    result: str,
    notes: Sequence[str],
    settings: Mapping[str, Any] | None,
    settings_of: str,
) -> str:
    """Return the page of some images; `hint` and `result` are HTML, all else is text."""
    drawn = clouds(maps)
    cut = [(i.label, i.image) for i in inputs if isinstance(i.image, Volume)]
    slices = slice_data(cut, maps[0].dynamic_range_db)
    return filled(
        title,
        notes,
        [cloud.colour for cloud in drawn],
        {**view_data(maps, drawn), "slices": slices, "panels": panels},
        dynamic_range_db=maps[0].dynamic_range_db,
        slices_hidden="" if slices else " hidden",
        figure_heading="Images" if len(inputs) > 1 else "Image",
        figure=base64.b64encode(png_bytes(figure, dpi=FIGURE_DPI)).decode("ascii"),
        figure_text=escaped(figure_text),
        figure_hint=hint.format(dynamic_range=f"{maps[0].dynamic_range_db:g}"),
        clouds="".join(map(_cloud_toggle, count(), inputs, drawn)),
        slices_note=_slices_note(slices),
        result=result,
        inputs="".join(_input_details(i, m) for i, m in zip(inputs, maps, strict=True)),
        settings=details(settings_of, settings_table(settings)) if settings else "",
    )


def _slices_note(slices: Mapping[str, Any] | None) -> str:
    if slices is None or slices["factor"] == 1:
        return ""
    n = slices["factor"]
    return f" To keep the page small, each voxel is the maximum of {n} along each axis."


def _cloud_toggle(i: int, entry: ReportImage, cloud: Cloud) -> str:
    kept, checked = len(cloud.points_mm), " checked" if i < SHOWN_FIRST else ""
    count = f"{kept} points" if kept == cloud.total else f"{kept} of {cloud.total} points"
    return (
        f'<label><input type="checkbox" data-cloud="{i}"{checked}>'
        f'<span class="swatch cloud-{i}"></span><span class="name">{escaped(entry.label)}</span> '
        f'<span class="count">{count}</span></label>'
    )


def _input_details(entry: ReportImage, shown: DepthMap) -> str:
    meta = entry.meta
    if meta is None:
        meta = entry.image.meta if isinstance(entry.image, Volume) else {}
    facts = settings_table(image_facts(entry.image, shown, entry.source))
    known = settings_table(meta) if meta else "<p>The image has no record of its origin.</p>"
    return details(entry.label, f"{facts}<h3>Settings and provenance</h3>{known}")
