"""The command that runs: its options, what it reads and may write, for what it writes of that."""

from __future__ import annotations

from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clradar.files.hashing import content_record


@dataclass
class Call:
    """A command, its options that count for results, all that were typed, inputs and outputs."""

    command: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    typed: Set[str] = frozenset()
    inputs: dict[str, list[Path]] = field(default_factory=dict)  # by option: files and folders
    force: bool = False
    read: dict[Path, list[Path]] = field(default_factory=dict)  # of an input: its files
    records: dict[Path, dict[str, Any]] = field(default_factory=dict)  # of files, by content

    @property
    def paths(self) -> list[Path]:
        """All inputs, as they were typed."""
        return [path for paths in self.inputs.values() for path in paths]

    def files_of(self, paths: Iterable[Path]) -> list[Path]:
        """The files whose content these inputs are, each once."""
        found = (file for path in paths for file in self.read.get(path, [path]))
        return [*dict.fromkeys(one for file in found if not file.is_dir() for one in _parts(file))]

    def records_of(self, files: Iterable[Path]) -> dict[Path, dict[str, Any]]:
        """What files held when it was first asked for: before the work (`content_record`)."""
        self.records |= {path: content_record(path) for path in files if path not in self.records}
        return self.records


def _parts(file: Path) -> list[Path]:
    """A file, and those that belong to it: buffers of glTF, the antennas of a recorded frame."""
    if file.suffix == ".npy":
        from measurement_io.maroon.folders import antennas_file

        antennas = antennas_file(file)
        return [file, antennas] if antennas is not None and antennas.is_file() else [file]
    from clradar.files.meshes.gltf_document import files_of

    return files_of(file)


call = Call()


def plain(value: Any, *, paths: bool = True) -> Any:
    """A value in types that JSON reads back as they were; None in place of `paths`, if wanted."""
    if isinstance(value, Path):
        return str(value) if paths else None
    if isinstance(value, dict):
        return {name or "": plain(item, paths=paths) for name, item in value.items()}
    many = isinstance(value, list | tuple)
    return [plain(item, paths=paths) for item in value] if many else value
