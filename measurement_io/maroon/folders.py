"""Find frames in the folders of a recording.

<object>/<distance>/radar_<low GHz>_<high GHz>_<points>/calibrated_data/%06d[_emptyfiltered].npy
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from clradar.files.failures import clean, fail, reading

VARIANTS = ("raw", "emptyfiltered")
FRAMES_FOLDER = "calibrated_data"
CALIBRATION_FILE = "calibration.json"
DISTANCE_FOLDERS = ("30", "40", "50")
"""Names of distance folders that are a distance in centimetres."""

METADATA_FILE, ALIGNMENT_FILE, MESH_FOLDER = "metadata.json", "alignment.json", "photogrammetry"
ANTENNAS_FILE = "antennas.toml"
"""In a radar folder: the antennas, where they are not those of the imager."""

PRODUCTS = {"depth": "png", "maxproj": "png", "volume": "ply", "xyz": "ply"}
"""Folders of images that the dataset has of its frames, and the extension of their files."""

BESIDE = (METADATA_FILE, ALIGNMENT_FILE, MESH_FOLDER)
"""What lies beside a radar folder and belongs to its recording."""

_NUMBER = r"([0-9]+(?:\.[0-9]+)?(?:e-?[0-9]+)?)"
_RADAR = re.compile(rf"radar_{_NUMBER}_{_NUMBER}_([0-9]{{1,9}})\Z")
_FRAME = re.compile(r"([0-9]{6})(_emptyfiltered)?\.npy\Z")


@dataclass(frozen=True, slots=True)
class RadarFolderName:
    """Frequencies in the name of a radar folder, with as many digits as the name has."""

    low_ghz: Decimal
    high_ghz: Decimal
    points: int

    @classmethod
    def parse(cls, name: str) -> RadarFolderName | None:
        """Parse `name`; None if it is no radar folder's name."""
        match = _RADAR.match(name)
        return cls(Decimal(match[1]), Decimal(match[2]), int(match[3])) if match else None

    def agrees_hz(self, low_hz: float, high_hz: float) -> bool:
        """Whether these frequencies, rounded to the name's digits, are the name's."""
        for named, value_hz in ((self.low_ghz, low_hz), (self.high_ghz, high_hz)):
            # Half of the last digit, and a little for frequencies that come from float steps.
            half = Decimal(10) ** int(named.as_tuple().exponent) / 2
            if abs(value_hz / 1e9 - float(named)) > float(half) + 1e-9 * float(named):
                return False
        return True


@dataclass(frozen=True, slots=True)
class FrameFile:
    """A frame's file, with number, variant and radar folder by its name and place, if any."""

    path: Path
    frame: int | None
    variant: str
    folder: RadarFolderName | None


def frame_file(path: Path) -> FrameFile:
    """Return number, variant and folder of a `.npy` file by its name and place."""
    match, frames = _FRAME.match(path.name), path.absolute().parent
    inside = frames.name == FRAMES_FOLDER
    folder = RadarFolderName.parse(frames.parent.name) if inside else None
    variant = "emptyfiltered" if match and match[2] else "raw"
    return FrameFile(path, int(match[1]) if match else None, variant, folder)


def antennas_file(frame: Path) -> Path | None:
    """Return where the antennas of a frame in a radar folder are, if not those of the imager."""
    return frame.absolute().parents[1] / ANTENNAS_FILE if frame_file(frame).folder else None


def entries(folder: Path) -> list[Path]:
    """Return the entries of a folder, sorted by name."""
    with reading(folder, "a readable folder"):
        return sorted(folder.iterdir())


def find_radar_folder(folder: Path) -> Path:
    """Return the radar folder that `folder` is, or the only one that it holds."""
    if RadarFolderName.parse(folder.absolute().name) is not None:
        return folder
    inside = [p for p in entries(folder) if p.is_dir()]
    radars = [p for p in inside if RadarFolderName.parse(p.name) is not None]
    expected = "a folder radar_<low GHz>_<high GHz>_<points>, or one that holds it"
    if len(radars) == 1:
        return radars[0]
    if radars:
        got = f"{len(radars)}: {_listed([p.name for p in radars])}"
        fail(folder, "one radar folder; name the one you mean", got)
    found = _listed([p.name for p in entries(folder)])
    fail(folder, expected, f"a folder with {found or 'nothing in it'}")


def frames(radar: Path) -> dict[str, dict[int, Path]]:
    """Return the frame files of a radar folder: variant, then number, then path."""
    found: dict[str, dict[int, Path]] = {variant: {} for variant in VARIANTS}
    data = radar / FRAMES_FOLDER
    if not data.is_dir():
        fail(radar, f"a folder {FRAMES_FOLDER} in it", "none")
    for path in entries(data):
        match = _FRAME.match(path.name)
        if match is not None:
            found["emptyfiltered" if match[2] else "raw"][int(match[1])] = path
    return found


def product_files(radar: Path, product: str) -> dict[int, Path]:
    """Return the files of one product of a radar folder by the number of their frame."""
    folder = radar / product
    with reading(folder, "a folder of products"):
        if not folder.is_dir():
            return {}
    name = re.compile(rf"([0-9]{{6}})\.{PRODUCTS[product]}")
    return {int(found[1]): p for p in entries(folder) if (found := name.fullmatch(p.name))}


def ignored_files(radar: Path) -> list[str]:
    """Return the names among the frames that are not named like one; hidden files apart."""
    names = [path.name for path in entries(radar / FRAMES_FOLDER)]
    return [clean(n) for n in names if not n.startswith(".") and not _FRAME.match(n)]


def find_frame(radar: Path, frame: int, variant: str) -> Path:
    """Return the file of one frame; the error lists the frames there are."""
    there = frames(radar)[variant]
    if frame in there:
        return there[frame]
    fail(radar, f"frame {frame} ({variant})", ranges(there) or f"no frame of variant {variant}")


def ranges(numbers: Iterable[int]) -> str:
    """Return numbers in words, "0-3, 5"; empty for none."""
    runs: list[list[int]] = []
    for n in sorted(numbers):
        if runs and n == runs[-1][1] + 1:
            runs[-1][1] = n
        else:
            runs.append([n, n])
    return _listed([str(a) if a == b else f"{a}-{b}" for a, b in runs])


def is_own_name(folder: Path, name: str) -> bool:
    """Whether what has this name in a folder belongs to the recordings that the folder holds."""
    radar = RadarFolderName.parse(name) is not None and (folder / name / FRAMES_FOLDER).is_dir()
    return radar or (name in BESIDE and any(RadarFolderName.parse(p.name) for p in entries(folder)))


def _listed(names: list[str]) -> str:
    shown = [clean(name) for name in names[:12]]
    return ", ".join(shown) + (f", ... ({len(names)} in all)" if len(names) > 12 else "")
