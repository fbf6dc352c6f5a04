"""The items of a job on the workers of a Dask client.

Dask schedules the items, retries failed ones and restarts dead workers. This module limits the
number of submitted items, checks that workers are alike, and interprets outcomes.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from socket import gethostname
from time import monotonic, sleep
from typing import Any

from distributed import CancelledError, Client, Future, KilledWorker, as_completed
from distributed.comm import CommClosedError

from clradar.errors import ClradarError, ClusterError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import shown
from clradar.files.json_differences import differences
from clradar.jobs.cluster import DEVICE
from clradar.jobs.outcome import ATTEMPTS, Outcome, outcome_of, reason_of
from clradar.jobs.resources import made_with
from clradar.opencl import open_device
from clradar.versions import own_version

WAITING = 2
"""Submitted items per worker: the one being made, and the next."""

LATE_S, LATE_STEP_S = 120.0, 0.05
"""Longest wait for items that are made twice, and the interval of polling."""

LOOK_S = 10.0
"""Interval at which the number of workers is read."""

FIRST_S, RETURN_S = 10.0, 600.0
"""Longest wait for a worker: for a first one, and for one that died, which its nanny starts again
however busy the machine is."""

KILLED = "its worker process died each time"


class ItemError(Exception):
    """An item could not be made, with the reason as text, so that it can be pickled."""


def worker_facts(device: str | None) -> dict[str, Any]:
    """The versions and the device of the worker that runs this."""
    return made_with(open_device(device))


@dataclass(frozen=True, slots=True)
class Contract:
    """Conditions on a worker, which each process verifies before its first item."""

    made_with: str
    device: str | None
    token_file: Path
    token: str
    files: tuple[str, ...]

    def breach(self) -> str | None:
        """The condition that this process violates, or None."""
        different = differences(json.loads(self.made_with), worker_facts(self.device))
        if different:
            return f"expected versions and device of the other workers: {'; '.join(different)}"
        token, folder = "", self.token_file.parent
        with suppress(OSError, ValueError):
            token = self.token_file.read_text(encoding="ascii")
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


def run_item(steps: Any, item: Any, here: str, contract: Contract) -> Outcome:
    """Run the steps of an item: the task that Dask runs."""
    breach = _breach(contract)
    if breach is not None:
        return OutputError(f"worker on {gethostname()}: {breach}"), []
    before = os.getcwd()
    # Names of files may be relative to the client's folder; the contract has tried all of them.
    moves = before != here and os.path.isdir(here)
    try:
        if moves:
            os.chdir(here)
        return outcome_of(replace(steps, device=open_device(contract.device)).run, item, None)
    except Exception as error:
        raise ItemError(reason_of(error)) from None
    finally:
        if moves:
            os.chdir(before)


class Distributed:
    """The workers of a Dask client."""

    def __init__(
        self,
        client: Client,
        device: str | None = None,
        *,
        end_workers: Callable[[], None] | None = None,
    ) -> None:
        self.client, self.device = client, device
        self._end_workers = end_workers
        self._pending: dict[Future, int] = {}
        self._window, self._counted_s = 1, -LOOK_S

    def outcomes(
        self, steps: Any, items: Sequence[Any], folder: Path, files: Sequence[str]
    ) -> Iterator[tuple[int, Outcome]]:
        """Yield the number of each item with its outcome, as soon as it is known.

        When a worker dies, Dask blames all items that it had. So those that it gives up are
        retried at the end, each alone in the whole cluster. Workers that died are back at the end.
        """
        with _contract(folder, self.made_with(), self.device, files) as contract:
            for address, breach in self._results_of(_breach, contract).items():
                if breach is not None:
                    raise ClusterError(f"{address}: {breach}")
            made = lambda *some: self._made(steps, dict(some), os.getcwd(), contract)  # noqa: E731
            blamed = []
            for number, outcome in made(*enumerate(items)):
                if outcome is None:
                    blamed.append(number)
                else:
                    yield number, outcome
            for number in sorted(blamed):
                again = made((number, items[number])) if len(items) > 1 else [(number, None)]
                for _, outcome in again:
                    yield number, outcome or (ClradarError(KILLED), [])
            if blamed:
                self._await_workers(RETURN_S)

    def _made(
        self, steps: Any, items: dict[int, Any], here: str, contract: Contract
    ) -> Iterator[tuple[int, Outcome | None]]:
        """The same without another try; None where a worker died."""
        left, run = iter(items.items()), secrets.token_hex(4)
        finished = as_completed([], loop=self.client.loop)
        for _ in range(len(items)):
            while len(self._pending) < self._most():
                number, item = next(left, (None, None))
                if number is None:
                    break
                future = self.client.submit(
                    run_item, steps, item, here, contract, key=("item", run, number),
                    resources={DEVICE: 1}, retries=ATTEMPTS - 1,
                )  # fmt: skip
                self._pending[future] = number
                finished.add(future)
            future = next(finished)
            yield self._pending.pop(future), _outcome(future)
        self._await_late(run)

    def workers(self) -> list[str]:
        """The addresses of the workers with a device."""
        known = self.client.scheduler_info(n_workers=-1)["workers"]
        return [address for address, worker in known.items() if worker["resources"].get(DEVICE)]

    def _most(self) -> int:
        """How many items may be submitted; it follows the number of workers."""
        now_s = monotonic()
        if now_s >= self._counted_s + LOOK_S:
            self._counted_s = now_s
            self._window = max(1, WAITING * len(self.workers()))
        return self._window

    def made_with(self) -> Mapping[str, Any]:
        """Versions and device of all workers."""
        facts = self._results_of(worker_facts, self.device)
        (first, known), *others = facts.items()
        if known["clradar"] != own_version():
            own = f"clradar {own_version()} as on the client"
            raise ClusterError(f"{first}: expected {own}, got {known['clradar']}")
        for address, fact in others:
            different = differences(known, fact)
            if different:
                raise ClusterError(
                    f"{address}: expected a worker that is as {first}, since a sample's bits "
                    f"depend on it: {'; '.join(different)}"
                )
        return known

    def _await_workers(self, limit_s: float) -> list[str]:
        """The addresses of the workers with a device, once there is one."""
        until_s = monotonic() + limit_s
        while not (workers := self.workers()):
            if monotonic() > until_s:
                address = self.client.scheduler_info(n_workers=0)["address"]
                raise ClusterError(
                    f"{address}: expected workers with a device, got none; start some by: "
                    f'dask worker {address} --nthreads 1 --memory-limit 0 --resources "{DEVICE}=1"'
                )
            sleep(LATE_STEP_S)
        return workers

    def _results_of(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        answers: dict[str, Any] = {}
        limit_s = FIRST_S
        while not answers:
            workers = self._await_workers(limit_s)
            found = self.client.run(function, *arguments, workers=workers, on_error="return")
            # One that has died is not asked again until it is back under another address.
            answers = {at: one for at, one in found.items() if not isinstance(one, OSError)}
            limit_s = RETURN_S
        for address, answer in answers.items():
            if isinstance(answer, Exception):
                raise ClusterError(
                    f"{address}: cannot make samples of clradar {own_version()}: "
                    f"{reason_of(answer)}"
                ) from answer
        return answers

    def _await_late(self, run: str) -> None:
        """Wait for items that are made twice, so that no file is written after the run.

        Dask reschedules the items of a dying worker, even finished ones.
        """
        until_s = monotonic() + LATE_S
        while monotonic() < until_s:
            if not any(self.client.run(_is_busy, run, on_error="ignore").values()):
                return
            sleep(LATE_STEP_S)

    def stop(self) -> None:
        """Submit no more, and end the workers if this process started them.

        Workers of a running cluster finish the items that they have begun, and leave what they
        made to the next run.
        """
        with suppress(Exception):
            self.client.cancel(list(self._pending))
        self._pending.clear()
        if self._end_workers is not None:
            self._end_workers()


def _is_busy(run: str, dask_worker: Any) -> bool:
    """Whether a worker is making an item of a run."""
    keys = list(dask_worker.active_threads.values())
    return any(isinstance(key, tuple) and key[:2] == ("item", run) for key in keys)


def _outcome(future: Future) -> Outcome | None:
    try:
        made: Outcome = future.result()
    except ItemError as error:
        return ClradarError(str(error)), []
    except KilledWorker:
        return None
    except (CancelledError, CommClosedError) as error:
        raise ClusterError(
            "the scheduler is gone, or cancelled the samples; the same command resumes"
        ) from error
    except Exception as error:
        raise ClusterError(f"{future.key[-1]}: a worker failed: {reason_of(error)}") from error
    return made


@contextmanager
def _contract(
    folder: Path, made_with: Mapping[str, Any], device: str | None, files: Sequence[str]
) -> Iterator[Contract]:
    """Yield the conditions on workers, with the token file in the folder meanwhile."""
    token = secrets.token_hex(16)
    # A later run removes it as a temporary file, if this one is killed.
    token_file = folder.absolute() / f".visible.{token}.tmp"
    write_file(token_file, token.encode("ascii"))
    try:
        yield Contract(json.dumps(made_with), device, token_file, token, tuple(files))
    finally:
        with suppress(OSError):
            token_file.unlink()
