"""A map-style data set for PyTorch, which is imported with the first sample."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from clradar.dataset.plan.plan import PRODUCTS
from clradar.dataset.plan.recipe import recipe
from clradar.dataset.readers.index import read_index
from clradar.dataset.store.shard_reader import opened_shard
from clradar.dataset.store.shard_schema import FIELDS, OF_SEQUENCES, labels_of
from clradar.errors import ClradarError
from clradar.model import checks

OPEN_FILES = 8
"""Shards that a process keeps open."""

SIDES = ("right", "left")


class TorchDataset:
    """Samples as dictionaries of tensors, for `torch.utils.data.DataLoader`.

    Parameters
    ----------
    folder : path-like
        A data set, as ``clradar dataset`` writes it.
    names : sequence of str
        Keys of each sample: products that all have one shape ("max_projection", "depth_map",
        "volume", "capture", "joints"), labels ("alpha", "angles_rad", "center_m", ...), "pose" and
        "handedness" as numbers (see `poses`; 0 is right, 1 left), and "sample", its number in the
        plan.
    transform : callable, optional
        Applied to each dictionary.
    sequences : bool
        Of a data set whose plan has [movement]: an item is a sequence, and each value has its
        frames along a first axis. Sequences that lack a frame are left out.

    Attributes
    ----------
    poses : tuple of str
        Names of the poses by their numbers in "pose".

    Raises
    ------
    ModelError
        A name that the data set lacks.
    MeasurementError
        The folder is no data set.

    Notes
    -----
    It can be pickled, and forked: each process of a `DataLoader` opens its own files. Depth maps
    have NaN where there is no depth.

    Examples
    --------
    >>> from pathlib import Path
    >>> from clradar.dataset import TorchDataset, read_plan, run
    >>> _ = Path("plan.toml").write_text('''samples = 2
    ... poses.names = ["A", "B"]
    ... output.products = ["joints"]''')
    >>> result = run(read_plan("plan.toml"), Path("letters"))
    >>> data = TorchDataset("letters", ("joints", "pose"))
    >>> len(data), data.poses  # data[0]["joints"] is a tensor of shape (25, 3)
    (2, ('A', 'B'))
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        names: Sequence[str] = ("max_projection", "pose"),
        transform: Callable[[dict[str, Any]], Any] | None = None,
        *,
        sequences: bool = False,
    ) -> None:
        self._index = read_index(folder)
        self._rows = self._index.sequences("TorchDataset") if sequences else None
        plan = self._index.manifest.plan
        self.poses = tuple(pose.name for pose in plan.poses.poses)
        self._names, self._transform = tuple(names), transform
        numbers = [n for n, label in labels_of(recipe(plan, 0)).items() if label.axes]
        arrays = [n for n in PRODUCTS if n in plan.output.products and n in FIELDS]
        known = [*arrays, *numbers, "handedness", "sample"]
        if plan.movement is not None:
            known += OF_SEQUENCES
        named = plan.poses.kind in ("list", "around")
        if named and (plan.movement is None or plan.movement.poses == "stay"):
            known.append("pose")
        for name in self._names:
            checks.one_of("TorchDataset: names", name, tuple(known))
        self._open: OrderedDict[Path, tuple[ExitStack, Any]] = OrderedDict()
        self._process, self._inherited = os.getpid(), list[Any]()

    def __len__(self) -> int:
        return len(self._index) if self._rows is None else len(self._rows)

    def __getitem__(self, position: int) -> Any:
        """Return the sample or sequence at a position, negative ones from the end.

        Raises
        ------
        IndexError
            There is no such position.
        ClradarError
            PyTorch is not installed.
        """
        try:
            import torch
        except ImportError as error:
            raise ClradarError(f"TorchDataset: expected PyTorch, got {error}") from error
        at = position + len(self) if position < 0 else position
        if not 0 <= at < len(self):
            raise IndexError(f"position {position} of a data set of {len(self)} samples")
        if self._rows is None:
            values = self._values(at)
        else:
            frames = [self._values(int(frame)) for frame in self._rows[at]]
            values = {name: np.stack([own[name] for own in frames]) for name in self._names}
        sample = {name: torch.as_tensor(value) for name, value in values.items()}
        return sample if self._transform is None else self._transform(sample)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict(), "_inherited": []}

    def close(self) -> None:
        """Close the files; the next sample opens them again."""
        while self._open:
            self._open.popitem()[1][0].close()

    def _values(self, position: int) -> dict[str, Any]:
        path, row = self._index.locate(position)
        file = self._file(path)
        return {name: self._value(file, name, row) for name in self._names}

    def _value(self, file: Any, name: str, row: int) -> Any:
        if name == "sample":
            return int(file["entry/labels/sample"][row])
        if name == "handedness":
            return SIDES.index(file["entry/labels/handedness"][row].decode())
        if name == "pose":
            return self.poses.index(file["entry/labels/pose"][row].decode("utf-8"))
        spec = FIELDS.get(name)
        place = f"entry/labels/{name}" if spec is None else spec.place
        return np.asarray(file[place][row])

    def _file(self, path: Path) -> Any:
        if self._process != os.getpid():
            # Files of the process that this one was forked from are kept, and not used: they share
            # the place in the file with it.
            self._inherited.append(self._open)
            self._open, self._process = OrderedDict(), os.getpid()
        if path in self._open:
            self._open.move_to_end(path)
            return self._open[path][1]
        stack = ExitStack()
        file = stack.enter_context(opened_shard(path))
        self._open[path] = (stack, file)
        if len(self._open) > OPEN_FILES:
            self._open.popitem(last=False)[1][0].close()
        return file
