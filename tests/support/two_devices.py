"""What batches make on two devices: PoCL shows the CPU twice where POCL_DEVICES says so.

Run as a program, since POCL_DEVICES is read once per process; prints its findings as JSON.
"""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep
from typing import Any

import clradar
from clradar.errors import ClradarError, ClradarWarning, handled_warnings, warn
from clradar.opencl import Device

ENVIRONMENT = {"POCL_DEVICES": "pthread pthread", "CLRADAR_DEVICE": "pocl"}

N = 6


def met(item: tuple[int, str], device: Device) -> tuple[int, str]:
    """The item's number and the device; the first two wait for each other, so both have a turn."""
    number, folder = item
    (Path(folder) / str(number)).touch()
    for _ in range(10**5 if number < 2 else 0):
        if (Path(folder) / str(1 - number)).exists():
            break
        sleep(0.01)
    warn("each says this")
    return number, device.info.selector


def dying(item: str, device: Device) -> str:
    """Die on the second device."""
    if device.info.selector == "0:1":
        os.kill(os.getpid(), signal.SIGKILL)
    signal.pause()  # until the batch is ended
    return item


def findings_of(mode: str, folder: Path) -> Any:
    """What a process with two devices finds."""
    done = subprocess.run(
        [sys.executable, __file__, mode, str(folder)],
        env={**os.environ, **ENVIRONMENT, "TMPDIR": str(folder)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def error_of(call: Any) -> str:
    try:
        call()
    except ClradarError as error:
        return f"{type(error).__name__}: {error}"
    return "none"


def cluster(folder: str) -> None:
    """A data set by two workers with a device each, and by one device here."""
    from dataset_plans import digests, light_file

    from clradar.dataset import read_plan, run
    from clradar.jobs import Where
    from clradar.jobs.workers import Share, local_client, own_cores

    cores = own_cores()
    output = {"shard_size": 2, "products": ["capture", "max_projection"]}
    radar = {"every": 32, "steps": 4}
    plan = read_plan(light_file(Path(folder), samples=4, output=output, radar=radar))
    each = [Share(f"0:{i}", (cores[i % len(cores)],), 1) for i in range(2)]
    with local_client(each) as client:
        devices = client.run(lambda: clradar.open_device().info.selector)
        run(plan, Path(folder) / "cluster", where=Where(scheduler=client.scheduler.address))
    run(plan, Path(folder) / "here", device="0:0")
    findings = {
        "devices": sorted(devices.values()),
        "same": digests(Path(folder) / "cluster") == digests(Path(folder) / "here"),
    }
    print(json.dumps(findings))


def killed(folder: str) -> None:
    print(json.dumps(error_of(lambda: list(clradar.map_devices(dying, ["", ""])))))


def main(folder: str) -> None:
    warned: list[str] = []
    shown: list[tuple[int, int]] = []
    items = [(i, folder) for i in range(N)]
    with handled_warnings(warned.append):
        made = list(clradar.map_devices(met, items, progress=lambda *of: shown.append(of)))
    findings = {
        "made": made,
        "warned": warned,
        "shown": shown,
        "twice": error_of(lambda: clradar.map_devices(met, [], device="0:0,0:0")),
        "single": error_of(lambda: clradar.open_device("all")),
    }
    print(json.dumps(findings))


if __name__ == "__main__":
    import warnings

    warnings.simplefilter("ignore", ClradarWarning)
    {"batches": main, "killed": killed, "cluster": cluster}[sys.argv[1]](sys.argv[2])
