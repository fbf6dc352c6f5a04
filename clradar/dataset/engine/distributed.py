"""Make samples on the workers of a Dask cluster, of this machine or of many.

Dask places the samples, tries failed ones again, and starts dead workers anew. Here it is only said
how many are on their way at a time, and what becomes of each.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from socket import gethostname
from time import monotonic, sleep
from typing import Any

from distributed import CancelledError, Client, Future, KilledWorker, as_completed
from distributed.comm import CommClosedError

from clradar import __version__
from clradar.dataset.engine.cluster import DEVICE
from clradar.dataset.engine.serial import ATTEMPTS, Outcome, PartMaker, made_with, reason_of
from clradar.dataset.store.folder import Aside
from clradar.errors import ClusterError, OutputError
from clradar.files.atomic import replacing
from clradar.files.failures import shown
from clradar.files.json_differences import differences
from clradar.opencl import open_device

WAITING = 2
"""Samples on their way per worker: the one being made, and the next at hand."""

LATE_S, LATE_STEP_S = 120.0, 0.05
"""How long to wait for samples that are made twice, and how often to look."""

LOOK_S = 10.0
"""How often it is looked how many workers there are."""

KILLED = "its worker process died each time"


class SampleError(Exception):
    """A sample could not be made; the text says why. It can be sent between processes."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a worker cannot go on, whatever the sample."""

    reason: str


def worker_facts(device: str | None) -> dict[str, Any]:
    """Return versions and device of the worker that runs this."""
    return made_with(open_device(device))


@dataclass(frozen=True, slots=True)
class Contract:
    """What a worker has to agree with. Checked by each process before its first sample.

    Attributes
    ----------
    made_with : str
        Versions and device, as JSON.
    device : str or None
        See `clradar.open_device`.
    sign : Path
        A file in the data set's folder.
    content : str
        What it holds, by which another machine's folder of the same name is told apart.
    files : tuple of str
        Other files that samples need.
    """

    made_with: str
    device: str | None
    sign: Path
    content: str
    files: tuple[str, ...]

    def breach(self) -> str | None:
        """Return what is otherwise in this process, or None."""
        different = differences(json.loads(self.made_with), worker_facts(self.device))
        if different:
            return f"expected versions and device of the other workers: {'; '.join(different)}"
        try:
            content = self.sign.read_text(encoding="ascii")
        except (OSError, ValueError):
            content = ""
        folder = self.sign.parent
        if content != self.content:
            return f"cannot see the folder {shown(folder)} of the client; share it under this name"
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"may not write into {shown(folder)}"
        for file in self.files:
            if not os.path.isfile(file):
                return f"cannot see {shown(file)}; share it under this name"
        return None


@lru_cache(maxsize=4)
def _breach(contract: Contract) -> str | None:
    return contract.breach()


def make_part(sample: int, make: PartMaker, contract: Contract) -> int | Refusal:
    """Make a sample; what Dask runs.

    Raises
    ------
    SampleError
        The sample cannot be made: Dask tries it again.
    """
    breach = _breach(contract)
    if breach is not None:
        return Refusal(f"worker on {gethostname()}: {breach}")
    try:
        return make(sample)
    except OutputError as error:
        return Refusal(str(error))
    except Exception as error:
        raise SampleError(reason_of(error)) from None


class Distributed:
    """An engine that makes samples on the workers of a Dask client.

    Parameters
    ----------
    client : distributed.Client
    device : str or None
        See `clradar.open_device`; None is what each worker takes by itself (CLRADAR_DEVICE).
    end_workers : callable, optional
        Ends the workers, if they are this process's own.
    """

    def __init__(
        self,
        client: Client,
        device: str | None = None,
        *,
        end_workers: Callable[[], None] | None = None,
    ) -> None:
        self.client, self.device = client, device
        self._end_workers = end_workers
        self._pending: set[Future] = set()
        self._window, self._looked_s = 1, -LOOK_S

    def workers(self) -> list[str]:
        """Return the addresses of the workers that have a device to make samples on."""
        known = self.client.scheduler_info(n_workers=-1)["workers"]
        return [address for address, worker in known.items() if worker["resources"].get(DEVICE)]

    def window(self) -> int:
        """Return how many samples may be on their way; more when workers have come."""
        now_s = monotonic()
        if now_s >= self._looked_s + LOOK_S:
            self._looked_s = now_s
            self._window = max(1, WAITING * len(self.workers()))
        return self._window

    def made_with(self) -> Mapping[str, Any]:
        """Return versions and device of all workers.

        Raises
        ------
        ClusterError
            There are none: samples would wait for ever. Or they differ, so that a sample's bits
            would depend on who makes it.
        """
        facts = self._asked(worker_facts, self.device)
        for address, fact in facts.items():
            if fact["clradar"] != __version__:
                raise ClusterError(
                    f"{address}: expected clradar {__version__} as on the client, "
                    f"got {fact['clradar']}"
                )
        first, *others = facts.items()
        for address, fact in others:
            different = differences(first[1], fact)
            if different:
                raise ClusterError(
                    f"{address}: expected a worker that is as {first[0]}, since a sample's bits "
                    f"depend on it: {'; '.join(different)}"
                )
        return first[1]

    def _asked(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        workers = self.workers()
        if not workers:
            address = self.client.scheduler_info(n_workers=0)["address"]
            raise ClusterError(
                f"{address}: expected workers with a device, got none; start some by: "
                f'dask worker {address} --nthreads 1 --memory-limit 0 --resources "{DEVICE}=1"'
            )
        answers = self.client.run(function, *arguments, workers=workers, on_error="return")
        for address, answer in answers.items():
            if isinstance(answer, Exception):
                raise ClusterError(
                    f"{address}: cannot make samples of clradar {__version__}: {reason_of(answer)}"
                ) from answer
        return answers

    def outcomes(self, samples: Sequence[int], make: PartMaker) -> Iterator[Outcome]:
        """Yield what became of each sample as soon as it is known.

        When a worker dies, Dask blames all samples that it had. So those that are blamed too often
        are tried once more at the end, each alone in the whole cluster.

        Raises
        ------
        OutputError
            A part cannot be written.
        ClusterError
            A worker does not see the folder or has another version; or the scheduler is gone.
        """
        with _contract(make, self.made_with()) as contract:
            for address, breach in self._asked(_breach, contract).items():
                if breach is not None:
                    raise ClusterError(f"{address}: {breach}")
            blamed = []
            for outcome in self._made(samples, make, contract, self.window):
                if isinstance(outcome, Aside) and outcome.reason == KILLED:
                    blamed.append(outcome.sample)
                else:
                    yield outcome
            yield from self._made(sorted(blamed), make, contract, lambda: 1)

    def _made(
        self,
        samples: Sequence[int],
        make: PartMaker,
        contract: Contract,
        window: Callable[[], int],
    ) -> Iterator[Outcome]:
        left = iter(samples)
        run = secrets.token_hex(4)

        def submitted() -> list[Future]:
            futures = [
                self.client.submit(
                    make_part,
                    sample,
                    make,
                    contract,
                    key=("sample", run, sample),
                    resources={DEVICE: 1},
                    retries=ATTEMPTS - 1,
                )
                for sample in islice(left, max(0, window() - len(self._pending)))
            ]
            self._pending.update(futures)
            return futures

        finished = as_completed(submitted(), loop=self.client.loop)
        for future in finished:
            self._pending.discard(future)
            finished.update(submitted())
            yield _outcome(future)
        self._await_late(run)

    def _await_late(self, run: str) -> None:
        """Wait for samples that are made twice, so that no part is written after all is done.

        What a dying worker held is made again by another, also if it had been heard of already.
        """
        until_s = monotonic() + LATE_S
        while monotonic() < until_s:
            if not any(self.client.run(_is_busy, run, on_error="ignore").values()):
                return
            sleep(LATE_STEP_S)

    def stop(self) -> None:
        """Make no more, and end the workers if they are this process's own.

        Samples that workers of a running cluster have begun come to their end there; then their
        parts are there for the next run.
        """
        with suppress(Exception):
            self.client.cancel(list(self._pending))
        self._pending.clear()
        if self._end_workers is not None:
            self._end_workers()


def _is_busy(run: str, dask_worker: Any) -> bool:
    """Return whether a worker is making a sample of a run, wanted or not."""
    keys = list(dask_worker.active_threads.values())
    return any(isinstance(key, tuple) and key[:2] == ("sample", run) for key in keys)


def _outcome(future: Future) -> Outcome:
    sample = future.key[-1]
    try:
        made = future.result()
    except SampleError as error:
        return Aside(sample, str(error), ATTEMPTS)
    except KilledWorker as error:
        return Aside(sample, KILLED, error.allowed_failures + 1)
    except (CancelledError, CommClosedError) as error:
        raise ClusterError(
            "the scheduler is gone, or took the samples back; the same command goes on"
        ) from error
    except Exception as error:
        raise ClusterError(f"sample {sample}: a worker failed: {reason_of(error)}") from error
    if isinstance(made, Refusal):
        raise OutputError(made.reason)
    return made


@contextmanager
def _contract(make: PartMaker, made_with: Mapping[str, Any]) -> Iterator[Contract]:
    """Yield what workers have to agree with, and leave its sign in the folder meanwhile."""
    content = secrets.token_hex(16)
    # By its name, a later run takes it for what a killed process left.
    sign = make.folder / f".visible.{content}.tmp"
    names = [name for rig in make.plan.hands.rigs for name in (rig.file, rig.mapping)]
    files = [str(make.plan.folder / name) for name in names if name is not None]
    with replacing(sign) as temporary:
        temporary.write_text(content, encoding="ascii")
    try:
        yield Contract(json.dumps(made_with), make.device, sign, content, tuple(files))
    finally:
        with suppress(OSError):
            sign.unlink()
