"""Figure of a fitted hand over its measured image."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from calibration.hand_fit.result import ANGLE_NAMES, TIPS, HandFit, end_joints
from clradar.compare.images import depth_map_of
from clradar.constants import DYNAMIC_RANGE_DB
from clradar.hand import JOINT_NAMES
from clradar.hand.joints import CHAINS, JOINT_INDEX
from clradar.model import DepthMap, Scene, Volume
from clradar.model.length_unit import LengthUnit
from clradar.plot.drawing import LABEL_PT, MARGIN, TICK_PT, Extent, settled, text_height
from clradar.plot.images import image_figure

SILHOUETTE_PIXEL_M = 0.25e-3  # a tenth of what the imager resolves
BONES, OTHERS = "#56b4e9", "#d55e00"
"""Of the palette of Okabe and Ito (2008), which colour-blind readers distinguish; on a black
background, and on both scales."""

LEGEND_ROWS = 2


def hand_fit_figure(
    measured: Volume | DepthMap, fit: HandFit, *, dynamic_range_db: float = DYNAMIC_RANGE_DB
) -> Figure:
    """Draw a fitted hand over its measured image, down to the dynamic range.

    Axes: amplitude and depth, both with the outline of the mesh, its bones and joints; their colour
    bars. A joint is hollow, and its bone dashed, if the measurement does not tell one of its
    angles. Ellipses are two standard deviations of a tip, crosses the tips of other basins.
    """
    shown = depth_map_of(measured, dynamic_range_db, "measured image")
    figure = image_figure(shown, dynamic_range_db=dynamic_range_db)
    unit = Extent.around([shown]).unit
    # Before the ellipses, which may be large.
    settled(figure, text_height(LEGEND_ROWS, LABEL_PT) + MARGIN)
    panels = figure.axes[:2]
    for axes, colour in zip(panels, ("white", "black"), strict=True):
        draw_outline(axes, fit.scene, unit, colour)
        draw_tips(axes, fit, unit, colour)
    draw_skeleton(panels[1], fit, unit)
    handles, labels = panels[1].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower center", ncols=-(-len(labels) // LEGEND_ROWS),
        fontsize=TICK_PT, frameon=False, borderaxespad=0.2,
    )  # fmt: skip
    return figure


def draw_outline(axes: Axes, scene: Scene, unit: LengthUnit, colour: str) -> None:
    """Draw the silhouette of a mesh along z."""
    from PIL import Image, ImageDraw

    corners_m = scene.vertices_m[:, :2]
    margin_m = 2 * SILHOUETTE_PIXEL_M
    low_m = corners_m.min(axis=0) - margin_m
    counts = np.ceil((corners_m.max(axis=0) + margin_m - low_m) / SILHOUETTE_PIXEL_M).astype(int)
    image = Image.new("1", tuple(counts.tolist()))
    draw = ImageDraw.Draw(image)
    pixels = (corners_m - low_m) / SILHOUETTE_PIXEL_M
    for face in pixels[scene.faces].reshape(-1, 6).tolist():
        draw.polygon(face, fill=1)
    x, y = (
        unit.per_m * (low_m[i] + SILHOUETTE_PIXEL_M * (np.arange(counts[i]) + 0.5)) for i in (0, 1)
    )
    axes.contour(x, y, np.asarray(image, dtype=float), levels=[0.5], colors=colour, linewidths=0.8)


def draw_tips(axes: Axes, fit: HandFit, unit: LengthUnit, colour: str) -> None:
    """Draw the uncertainty of the tips, and the tips of other basins."""
    tips = unit.per_m * fit.tips_m[:, :2]
    for tip, covariance_m2 in zip(tips, fit.joint_covariance_m2[list(TIPS), :2, :2], strict=True):
        if np.isfinite([*tip, *covariance_m2.ravel()]).all():
            variance_m2, across = np.linalg.eigh(covariance_m2)
            diameters = 4 * unit.per_m * np.sqrt(np.maximum(variance_m2, 0.0))
            angle_deg = float(np.degrees(np.arctan2(across[1, 0], across[0, 0])))
            ring = Ellipse(
                tuple(tip), *diameters, angle=angle_deg, fill=False, color=colour, linewidth=1
            )
            axes.add_patch(ring)
    named: dict[str, Any] = {"linestyle": "none", "markersize": 5.0}
    if axes.patches:  # not of a rig without tips
        ring_label = "two standard deviations of a tip"
        axes.plot([], marker="o", color=colour, markerfacecolor="none", label=ring_label, **named)
    ends = end_joints(fit.joints_m)
    others = [unit.per_m * basin.joints_m[ends, :2] for basin in fit.basins[1:]]
    if others:
        axes.plot(
            *np.concatenate(others).T, marker="x", color=OTHERS, alpha=0.6,
            label="tips of other poses found", **named,
        )  # fmt: skip


def bones_between(joints: np.ndarray) -> Iterator[tuple[int, int]]:
    """Pairs of joints, of (25, ...), that a bone joins; what a rig does not have is left out."""
    for chain in CHAINS:
        joined = (JOINT_INDEX["wrist"], *chain)
        yield from pairwise(joint for joint in joined if np.isfinite(joints[joint]).all())


def draw_skeleton(axes: Axes, fit: HandFit, unit: LengthUnit) -> None:
    """Draw bones and joints."""
    joints = unit.per_m * fit.joints_m[:, :2]
    untold = {name.split()[0] for name in np.array(ANGLE_NAMES)[~fit.told_angles]}
    told = np.array([name not in untold for name in JOINT_NAMES])
    for begin, end in bones_between(joints):
        line = "-" if told[begin] else (0, (1.5, 1.0))
        axes.plot(*joints[[begin, end]].T, color=BONES, linestyle=line, linewidth=1.2)
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": BONES, "markersize": 3.0}
    axes.plot(*joints[told].T, label="joint", **dots)
    axes.plot(
        *joints[~told].T, markerfacecolor=axes.get_facecolor(), markeredgewidth=0.8,
        label="joint with an angle that is not determined", **dots,
    )  # fmt: skip
