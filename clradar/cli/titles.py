"""Titles of figures and reports: which recording, and which frame of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def title_of(path: Path, meta: Mapping[str, Any]) -> str:
    """Name what is in a file or folder: of a recording its object, distance, variant and frame.

    Parameters
    ----------
    path : Path
        As it was given: ``hand/30`` has the name 30, which says too little.
    meta : mapping
        Of the capture or the volume that was read.
    """
    from clradar.model.volume import capture_meta

    capture = capture_meta(meta)
    name = path.name or path.absolute().name or str(path)
    words = recording_words(meta)
    if not words:
        frame = capture.get("frame")
        return f"{name}, frame {frame}" if isinstance(frame, int) else name
    # A folder or a frame is where the words come from; another file has a name of its own.
    return words if path.is_dir() or path.suffix == ".npy" else f"{name}: {words}"


def recording_words(meta: Mapping[str, Any]) -> str:
    """Name object, distance, variant and frame of a recorded capture; empty for any other."""
    from clradar.model.volume import capture_meta

    capture = capture_meta(meta)
    if capture.get("format") != "maroon":
        return ""
    variant, frame = capture.get("variant"), capture.get("frame")
    parts = [*_recording(capture.get("source")), *([variant] if variant else [])]
    return ", ".join(map(str, [*parts, *([f"frame {frame}"] if isinstance(frame, int) else [])]))


def _recording(source: object) -> list[str]:
    """Return object and distance from the place of a recorded frame, as far as they are known."""
    from measurement_io.maroon.folders import frame_file
    from measurement_io.maroon.metadata import DISTANCE_FOLDERS

    if not isinstance(source, str):
        return []
    path = Path(source)
    if frame_file(path).folder is None:
        return [path.name]
    distance = path.absolute().parents[2]
    if distance.name not in DISTANCE_FOLDERS:
        return [distance.name]
    return [distance.parent.name, f"{distance.name} cm"]
