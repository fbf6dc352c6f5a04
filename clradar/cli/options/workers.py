"""Options of commands that divide their work among processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clradar.cli.on_workers import Cluster
from clradar.cli.options.groups import option
from clradar.cli.options.values import wrong_usage


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that the work is divided among."""

    workers: int | None = option(
        None,
        'Worker processes (pip install "clradar[dataset]"). [default: one after the other, here]',
        metavar="N",
        min=1,
    )
    scheduler: str | None = option(
        None,
        "The workers of a Dask scheduler, tcp://HOST:PORT, that see the same files; see "
        "docs/datasets-cluster.md.",
        metavar="ADDRESS",
    )

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise wrong_usage("--scheduler", "expected no --workers with it: it has its own")

    def chosen(self, folder: Path, files: Sequence[Path]) -> int | Cluster | None:
        """The workers; those of a scheduler have to see the folder and the files."""
        if self.scheduler is None:
            return self.workers
        return Cluster(self.scheduler, folder, files)
