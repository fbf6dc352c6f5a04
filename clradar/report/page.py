"""Self-contained HTML report: figure, 3-D view, metrics and settings in one file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import count
from string import Template
from typing import Any

from matplotlib.figure import Figure

from clradar.compare.images import depth_map_of
from clradar.compare.metrics import Metrics, compare
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.errors import CompareError
from clradar.model import DepthMap, Volume, checks
from clradar.plot import comparison_figure, image_figure
from clradar.plot.drawing import AMPLITUDE_SCALE, DEPTH_SCALE, colours_of
from clradar.plot.images import NOTE
from clradar.plot.saving import figure_bytes
from clradar.plot.views import FRONT, rcs_image, view_of
from clradar.report.tables import escaped, image_facts, metrics_section, script_json, settings_table
from clradar.report.view_data import Cloud, base64_of, clouds, panel_places, slice_data, view_data

SCRIPTS = ("shared.js", "viewer.js", "figure.js", "slices.js")  # one script in this order
FIGURE_DPI = 200  # resolution of the figure: sharp at twice the width that it has on a wide screen
PANEL_PX = 150
"""Least width of a panel of the figure; on a narrower screen the figure scrolls in its frame.
Slices need more: two panels are side by side."""

SHOWN_FIRST = 2
"""Clouds in the 3-D view when the page opens: the measurement and the first simulation."""

COMPARISON_HINT = """Amplitude above depth: {note} The background is more than
{dynamic_range}&nbsp;dB below the maximum. The lowest row shows where measurement and simulation
disagree: orange is stronger in the measurement than all of the simulation nearby, blue the other
way round, grey where both match; a ring surrounds an object that is missing from the simulation, a
dotted ring one in the simulation alone."""

IMAGE_HINT = """Amplitude and depth: {note} The background is more than {dynamic_range}&nbsp;dB
below the maximum."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportImage:
    """An image of a report with its name, source and settings (types of JSON; None: its own)."""

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

    The images are on the same pixels; `metrics` has one for each simulated one, None computes them
    with `clradar.compare`. `notes` are paragraphs below the title, `settings` those of the
    comparison, in types of JSON. The same arguments give the same text, to be written as UTF-8. It
    loads nothing, and texts of untrusted files are escaped.

    Examples
    --------
    >>> from clradar.report import ReportImage
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> near, far = (clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m) for z_m in (0.300, 0.302))
    >>> page = clradar.report.html_report(ReportImage("measured", near), [ReportImage("far", far)])
    >>> "overlap" in page
    True
    """
    dynamic_range_db = checks.dynamic_range("html_report: dynamic_range_db", dynamic_range_db)
    if not simulated:
        raise CompareError("html_report: expected at least one simulated image, got none")
    inputs = [measured, *simulated]
    for one in inputs:
        checks.instance("html_report: images", one, ReportImage)
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
        maps[0], list(zip(labels, maps[1:], strict=True)), metrics=metrics,
        measured_label=measured.label, dynamic_range_db=dynamic_range_db, differences=True,
    )  # fmt: skip
    return _page(
        title, inputs, maps, figure,
        panels=panel_places(figure, maps),
        figure_text=f"Amplitude above depth, in a row: {measured.label}; {'; '.join(labels)}",
        hint=COMPARISON_HINT,
        result=metrics_section(labels, metrics),
        notes=notes,
        settings=settings,
    )  # fmt: skip


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
    """Return a self-contained HTML page of one image, with figure, 3-D view, facts and provenance.

    `view` and `dbsm` are those of `clradar.plot.image_figure`, all else as in `html_report`.

    Examples
    --------
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> image = clradar.report.ReportImage("spot", clradar.DepthMap(0 * spot + 0.3, spot, x_m, x_m))
    >>> "at x = 0.0, y = 0.0, z = 300.0 mm" in clradar.report.image_report(image)
    True
    """
    dynamic_range_db = checks.dynamic_range("image_report: dynamic_range_db", dynamic_range_db)
    checks.instance("image_report: image", image, ReportImage)
    content = rcs_image(image.image) if dbsm else image.image
    shown = depth_map_of(content, dynamic_range_db, f"image '{image.label}'")
    figure = image_figure(image.image, dynamic_range_db=dynamic_range_db, view=view, dbsm=dbsm)
    front = view != "all" and len(figure.axes) == 4 and view_of(image.image, view) is FRONT
    facts = settings_table(image_facts(content, shown, image.source, dbsm=dbsm))
    return _page(
        image.label if title is None else title, [image], [shown], figure,
        panels=panel_places(figure, [shown]) if front else [],
        figure_text=f"Amplitude and depth: {image.label}",
        hint=IMAGE_HINT,
        result=f"<section><h2>Facts</h2>{facts}</section>",
        notes=notes,
        settings=settings,
    )  # fmt: skip


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
) -> str:
    """Return the page of some images; `hint` and `result` are HTML, all else is text."""
    dynamic_range_db = maps[0].dynamic_range_db
    drawn = clouds(maps)
    cut = [(i.label, i.image) for i in inputs if isinstance(i.image, Volume)]
    slices = slice_data(cut, dynamic_range_db)
    scales = {"level_colours": AMPLITUDE_SCALE, "depth_colours": DEPTH_SCALE}
    data = {
        **view_data(maps, drawn),
        **{name: base64_of(colours_of(scale).tobytes()) for name, scale in scales.items()},
        "slices": slices,
        "panels": panels,
    }
    style = _part("page.css") + _own_style([cloud.colour for cloud in drawn])
    script = "".join(map(_part, SCRIPTS))
    factor = slices["factor"] if slices is not None else 1
    coarser = f" To keep the page small, each voxel is the maximum of {factor} along each axis."
    return Template(_part("page.html")).substitute(
        title=escaped(title),
        style=style,
        style_hash=_policy_hash(style),
        script=script,
        script_hash=_policy_hash(script),
        notes="".join(
            f'<p class="note">{"<br>".join(map(escaped, note.splitlines()))}</p>' for note in notes
        ),
        view_data=script_json(data),
        slices_hidden="" if slices else " hidden",
        slices_note=coarser if factor > 1 else "",
        figure_heading="Images" if len(inputs) > 1 else "Image",
        figure=base64_of(figure_bytes(figure, dpi=FIGURE_DPI)),
        figure_text=escaped(figure_text),
        figure_hint=hint.format(dynamic_range=f"{dynamic_range_db:g}", note=NOTE),
        clouds="".join(map(_cloud_toggle, count(), inputs, drawn)),
        result=result,
        inputs="".join(_input_details(i, m) for i, m in zip(inputs, maps, strict=True)),
        settings=_details("This page", settings_table(settings)) if settings else "",
    )


def _part(name: str) -> str:
    return (resources.files("clradar") / "report" / name).read_text(encoding="utf-8")


def _policy_hash(content: str) -> str:
    """Return the name of an inline script or style in a content security policy."""
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"sha256-{base64_of(digest)}"


def _own_style(colours: Sequence[str]) -> str:
    """Return the style that depends on the images: the policy forbids style attributes."""
    swatches = "".join(f".cloud-{i}{{background:{c}}}\n" for i, c in enumerate(colours))
    least = max(len(colours), 2) * PANEL_PX
    widths = f".figure img,.columns{{min-width:{least}px}}#slices{{min-width:{1.6 * least:g}px}}"
    return f"@media screen{{{widths}}}\n{swatches}"


def _details(summary: str, content: str) -> str:
    """Return a folded section; `summary` is text, `content` is HTML."""
    return f"<details><summary>{escaped(summary)}</summary>{content}</details>"


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
    return _details(entry.label, f"{facts}<h3>Settings and provenance</h3>{known}")
