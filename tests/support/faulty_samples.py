"""Faults on demand in processes that make samples.

A preload of Dask workers (`dask.config`: distributed.worker.preload), and of this process by
`faults`. The file that FAULTS names holds JSON: {"3": "raise", ...}. Faults that end in " once"
happen one time only in all processes together.
"""

import errno
import json
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from clradar.dataset import runs
from clradar.dataset.shards import ShardWriter
from clradar.errors import DeviceError

VARIABLE = "CLRADAR_TEST_FAULTS"

_make_sample = runs.make_sample
_add = ShardWriter.add
_made: dict[str, Any] = {}


def make_once(recipe: Mapping[str, Any], device: Any, **settings: Any) -> Any:
    """Make a sample, or return what this process made of the same recipe before."""
    key = json.dumps([recipe, str(settings)])
    if key not in _made:
        _made[key] = _make_sample(recipe, device, **settings)
    return _made[key]


def plan_faults(faults: Mapping[int, str]) -> None:
    """Choose which sample fails how, from now on."""
    folder = tempfile.gettempdir()
    path = Path(os.environ.setdefault(VARIABLE, f"{folder}/clradar-faults-{os.getpid()}"))
    for mark in path.parent.glob(f"{path.name}.*"):
        mark.unlink()
    path.write_text(json.dumps(faults), encoding="ascii")


@contextmanager
def faults(planned: Mapping[int, str]) -> Iterator[Callable[[Mapping[int, str]], None]]:
    """Have samples fail in this process, and in workers that were preloaded with this file."""
    plan_faults(planned)
    with (
        mock.patch.object(runs, "make_sample", _faulty_make),
        mock.patch.object(ShardWriter, "add", _faulty_add),
    ):
        yield plan_faults
    plan_faults({})
    Path(os.environ[VARIABLE]).unlink()


def dask_setup(worker: Any) -> None:
    runs.make_sample = _faulty_make
    ShardWriter.add = _faulty_add  # type: ignore[method-assign]


def _fault(sample: int, kinds: tuple[str, ...]) -> str | None:
    path = Path(os.environ[VARIABLE])
    if not path.exists():
        return None
    wanted = json.loads(path.read_text(encoding="ascii")).get(str(sample), "")
    kind, _, once = wanted.partition(" ")
    if kind not in kinds:
        return None
    if once:
        try:
            path.with_name(f"{path.name}.{sample}").touch(exist_ok=False)
        except FileExistsError:
            return None
    return kind


def _faulty_make(recipe: Mapping[str, Any], device: Any, **settings: Any) -> Any:
    fault = _fault(recipe["sample"], ("raise", "device", "kill", "stop"))
    if fault == "raise":
        raise ValueError(f"sample {recipe['sample']} is poisoned")
    if fault == "device":
        raise DeviceError("the device refused")
    if fault == "stop":
        raise KeyboardInterrupt
    if fault == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    return make_once(recipe, device, **settings)


def _faulty_add(shard: ShardWriter, sample: Any, made_with: Any) -> None:
    fault = _fault(sample.recipe["sample"], ("full", "cut"))
    if fault == "full":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if fault == "cut":  # killed in the middle of writing
        os.kill(os.getpid(), signal.SIGKILL)
    _add(shard, sample, made_with)
