"""The page of a time line: a measurement and simulations over frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clradar.plot.panels import limits_of_depths_mm
from clradar.report.clouds import colour_of
from clradar.report.frames import FrameSeries, depths_mm, frame_data
from clradar.report.tables import metrics_section, settings_table
from clradar.report.template import NO_PICTURE, cloud_toggle, details, filled


def frames_report(
    series: FrameSeries,
    *,
    title: str = "Measurement against simulation, over frames",
    sources: Sequence[str] = (),
    notes: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
) -> str:
    """Return a self-contained HTML page with a time line over frames.

    Parameters
    ----------
    series : FrameSeries
        Every frame has been added.
    title : str
        Plain text.
    sources : sequence of str
        Where the images of each label come from: plain text.
    notes, settings
        As in `html_report`.

    Returns
    -------
    str
        As `html_report` returns it: a slider over the frames, their amplitudes and depths, a chart
        of each metric, the depth points of the frame in the 3-D view.

    Raises
    ------
    CompareError
        No frame has an image above zero.

    Examples
    --------
    >>> import numpy as np
    >>> import clradar
    >>> from clradar.report import FrameSeries, frames_report
    >>> x_m = np.arange(-10, 11) * 1e-3
    >>> spot = np.exp(-((np.hypot(x_m, x_m[:, None]) / 5e-3) ** 2))
    >>> series = FrameSeries(["measured", "simulated"])
    >>> for z_m in (0.300, 0.302):
    ...     image = clradar.DepthMap(0 * spot + z_m, spot, x_m, x_m)
    ...     found = series.add(f"{1e3 * z_m:g} mm", [image, image])
    >>> "300 mm to 302 mm" in frames_report(series)
    True
    """
    data = frame_data(series)
    colours = [colour_of(i) for i in range(len(series.labels))]
    means = [series.mean_metrics(i) for i in range(len(series.labels) - 1)]
    rows = {"frames": f"{len(series.names)}, {series.names[0]} to {series.names[-1]}"}
    named = [*sources, *[""] * (len(series.labels) - len(sources))]
    return filled(
        title,
        notes,
        colours,
        {
            "frames": data,
            "slices": None,
            "panels": [],
            "clouds": [{"colour": colour, "points_mm": "", "level": ""} for colour in colours],
            "pixel_mm": min(data["step"]),
            "depth_mm": list(limits_of_depths_mm(depths_mm(series))),
        },
        dynamic_range_db=series.dynamic_range_db,
        hidden={"figure", "slices"},
        **NO_PICTURE,
        frames_note=_note(data["factor"]),
        clouds="".join(cloud_toggle(i, label, "") for i, label in enumerate(series.labels)),
        result=metrics_section(
            series.labels[1:], means, f"Metrics, mean of {len(series.names)} frames"
        ),
        inputs="".join(
            details(label, settings_table({**({"file": source} if source else {}), **rows}))
            for label, source in zip(series.labels, named, strict=True)
        ),
        settings=details("This comparison", settings_table(settings)) if settings else "",
    )


def _note(factor: int) -> str:
    if factor == 1:
        return ""
    return f" To keep the page small, each pixel is the highest of {factor} by {factor}."
