"""The engine that makes samples, or other numbered work, on the workers of a Dask cluster.

Dask schedules the samples, retries failed ones and restarts dead workers. This module limits the
number of submitted samples and interprets their outcomes.
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
from typing import Any, Protocol

from distributed import CancelledError, Client, Future, KilledWorker, as_completed
from distributed.comm import CommClosedError

from clradar.errors import ClusterError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import shown
from clradar.files.json_differences import differences
from clradar.jobs.cluster import DEVICE
from clradar.jobs.outcome import ATTEMPTS, Aside, reason_of
from clradar.jobs.resources import made_with, own_device
from clradar.versions import own_version

WAITING = 2
"""Submitted samples per worker: the one being made, and the next."""

LATE_S, LATE_STEP_S = 120.0, 0.05
"""Longest wait for samples that are made twice, and the interval of polling."""

LOOK_S = 10.0
"""Interval at which the number of workers is read."""

RESTART_S = 10.0
"""Longest wait for a worker, where there is none."""

KILLED = "its worker process died each time"


class Maker(Protocol):
    """Work that can be sent to workers, such as `PartMaker`."""

    @property
    def folder(self) -> Path: ...

    @property
    def device(self) -> str | None: ...

    @property
    def files(self) -> tuple[str, ...]: ...

    def alone(self, sample: int) -> Maker:
        """The work without what only other samples need."""

    def __call__(self, sample: int) -> Any: ...


class SampleError(Exception):
    """A sample could not be made, with the reason as text, so that it can be pickled."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a worker can make no sample at all."""

    reason: str


def worker_facts(device: str | None) -> dict[str, Any]:
    """Return the versions and the device of the worker that runs this."""
    return made_with(own_device(device))


@dataclass(frozen=True, slots=True)
class Contract:
    """Conditions on a worker, which each process verifies before its first sample."""

    made_with: str
    device: str | None
    token_file: Path
    token: str
    files: tuple[str, ...]

    def breach(self) -> str | None:
        """Return the condition that this process violates, or None."""
        different = differences(json.loads(self.made_with), worker_facts(self.device))
        if different:
            return f"expected versions and device of the other workers: {'; '.join(different)}"
        try:
            token = self.token_file.read_text(encoding="ascii")
        except (OSError, ValueError):
            token = ""
        folder = self.token_file.parent
        if token != self.token:
            return f"cannot see the folder {shown(folder)} of the client; share it under this name"
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"may not write into {shown(folder)}"
        for file in self.files:
            if not os.path.exists(file):
                return f"cannot see {shown(file)}; share it under this name"
        return None


@lru_cache(maxsize=4)
def _breach(contract: Contract) -> str | None:
    return contract.breach()


def make_part(sample: int, make: Maker, contract: Contract) -> Any:
    """Make a sample: the task that Dask runs."""
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
    """An engine that makes samples on the workers of a Dask client."""

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
        self._window, self._counted_s = 1, -LOOK_S

    def workers(self) -> list[str]:
        """Return the addresses of the workers with a device."""
        known = self.client.scheduler_info(n_workers=-1)["workers"]
        return [address for address, worker in known.items() if worker["resources"].get(DEVICE)]

    def window(self) -> int:
        """Return how many samples may be submitted; it follows the number of workers."""
        now_s = monotonic()
        if now_s >= self._counted_s + LOOK_S:
            self._counted_s = now_s
            self._window = max(1, WAITING * len(self.workers()))
        return self._window

    def made_with(self) -> Mapping[str, Any]:
        """Return versions and device of all workers."""
        facts = self._results_of(worker_facts, self.device)
        for address, fact in facts.items():
            if fact["clradar"] != own_version():
                raise ClusterError(
                    f"{address}: expected clradar {own_version()} as on the client, "
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

    def _results_of(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        with suppress(TimeoutError):  # those that were killed are started again
            self.client.wait_for_workers(1, timeout=RESTART_S)
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
                    f"{address}: cannot make samples of clradar {own_version()}: "
                    f"{reason_of(answer)}"
                ) from answer
        return answers

    def outcomes(self, samples: Sequence[int], make: Maker) -> Iterator[Any]:
        """Yield the outcome of each sample as soon as it is known.

        When a worker dies, Dask blames all samples that it had. So those that it gives up are
        retried at the end, each alone in the whole cluster.
        """
        with _contract(make, self.made_with()) as contract:
            for address, breach in self._results_of(_breach, contract).items():
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
        make: Maker,
        contract: Contract,
        window: Callable[[], int],
    ) -> Iterator[Any]:
        left = iter(samples)
        run = secrets.token_hex(4)

        def submitted() -> list[Future]:
            futures = [
                self.client.submit(
                    make_part,
                    sample,
                    make.alone(sample),
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
        """Wait for samples that are made twice, so that no part is written after the run.

        Dask reschedules the samples of a dying worker, even finished ones.
        """
        until_s = monotonic() + LATE_S
        while monotonic() < until_s:
            if not any(self.client.run(_is_busy, run, on_error="ignore").values()):
                return
            sleep(LATE_STEP_S)

    def stop(self) -> None:
        """Submit no more, and end the workers if this process started them.

        Workers of a running cluster finish the samples that they have begun, and leave their parts
        to the next run.
        """
        with suppress(Exception):
            self.client.cancel(list(self._pending))
        self._pending.clear()
        if self._end_workers is not None:
            self._end_workers()


def _is_busy(run: str, dask_worker: Any) -> bool:
    """Return whether a worker is making a sample of a run."""
    keys = list(dask_worker.active_threads.values())
    return any(isinstance(key, tuple) and key[:2] == ("sample", run) for key in keys)


def _outcome(future: Future) -> Any:
    sample = future.key[-1]
    try:
        made = future.result()
    except SampleError as error:
        return Aside(sample, str(error), ATTEMPTS)
    except KilledWorker as error:
        return Aside(sample, KILLED, error.allowed_failures + 1)
    except (CancelledError, CommClosedError) as error:
        raise ClusterError(
            "the scheduler is gone, or cancelled the samples; the same command resumes"
        ) from error
    except Exception as error:
        raise ClusterError(f"sample {sample}: a worker failed: {reason_of(error)}") from error
    if isinstance(made, Refusal):
        raise OutputError(made.reason)
    return made


@contextmanager
def _contract(make: Maker, made_with: Mapping[str, Any]) -> Iterator[Contract]:
    """Yield the conditions on workers, with the token file in the folder meanwhile."""
    token = secrets.token_hex(16)
    # A later run removes it as a temporary file, if this one is killed.
    token_file = make.folder / f".visible.{token}.tmp"
    write_file(token_file, token.encode("ascii"))
    try:
        yield Contract(json.dumps(made_with), make.device, token_file, token, make.files)
    finally:
        with suppress(OSError):
            token_file.unlink()
