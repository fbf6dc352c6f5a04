"""Captures and volumes from files, as images to compare and to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.cli.output import progress_bar
from clradar.cli.provenance import provenance

if TYPE_CHECKING:
    from clradar import Capture, Device, Volume, VoxelGrid


def open_image(
    path: Path, *, frame: int | None = None, variant: str | None = None
) -> Volume | Capture:
    """Return what a file or folder holds: a volume, or a capture that is still to be imaged.

    `frame` and `variant` choose from a recording; that there is nothing to choose from is an error.
    """
    from measurement_io import open_capture, open_volume
    from measurement_io.native.captures_volumes import read_header
    from measurement_io.opening import kind_of

    chosen = frame is not None or variant is not None
    if not chosen and kind_of(path) == "native" and read_header(path).format == "volume":
        return open_volume(path)
    return open_capture(path, frame=frame, variant=variant)


def form_image(
    capture: Capture,
    grid: VoxelGrid,
    method: str,
    window: str,
    device: Device,
    label: str,
    tolerance_db: float | None = None,
) -> Volume:
    """Return the image of a capture, with a progress bar on a terminal."""
    from clradar import backproject

    with progress_bar(label) as progress:
        return backproject(
            capture, grid, method=method, window=window, tolerance_db=tolerance_db, device=device,
            progress=progress,
        )  # fmt: skip


def formed(
    path: Path,
    image: Volume | Capture,
    grid: VoxelGrid,
    method: str,
    window: str,
    device: Device,
) -> Volume:
    """Return what `open_image` gave as a volume: captures are imaged on `grid`."""
    from clradar import Volume

    if isinstance(image, Volume):
        return image
    return form_image(image, grid, method, window, device, f"imaging {path.name}")


def save_image(
    path: Path,
    volume: Volume,
    command: str,
    options: Mapping[str, Any],
    inputs: Sequence[Path],
    *,
    force: bool,
) -> None:
    """Write a volume with the record of how it came to be."""
    from measurement_io import save_volume

    meta = {**volume.meta, **provenance(command, options, inputs)}
    save_volume(path, replace(volume, meta=meta), force=force)


def alpha_of(meta: Mapping[str, Any]) -> float | None:
    """Return the alpha that a capture or volume was simulated with, None if not one number."""
    capture = meta.get("capture")
    scene = (capture if isinstance(capture, Mapping) else meta).get("scene")
    if not isinstance(scene, Mapping):
        return None
    low, high = scene.get("alpha_min"), scene.get("alpha_max")
    if not isinstance(low, int | float) or low != high:
        return None
    return float(low)


def labels_of(paths: Sequence[Path], metas: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a short label for each image: its alpha where that tells them apart, else its name."""
    alphas = [alpha_of(meta) for meta in metas]
    labels = []
    for path, alpha in zip(paths, alphas, strict=True):
        if alpha is None or alphas.count(alpha) > 1:
            labels.append(path.stem or path.name or str(path))
        else:
            labels.append(f"\N{GREEK SMALL LETTER ALPHA} = {alpha:.3g}")
    # Files of the same name in different folders: the whole path tells them apart.
    return [
        str(path) if labels.count(label) > 1 else label
        for path, label in zip(paths, labels, strict=True)
    ]


def recording_files(path: Path, capture_meta: Mapping[str, Any]) -> list[Path]:
    """Return the files whose content a capture comes from: the frame's, if `path` is a folder."""
    if not path.is_dir():
        return [path]
    source = capture_meta.get("source")
    frame = Path(source) if isinstance(source, str) else None
    return [frame] if frame is not None and frame.is_file() else []
