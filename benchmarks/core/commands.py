"""Time and peak memory of commands in a process of their own."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import clradar
from core.timing import Row

PEAK_MEMORY = """
import sys
from clradar.cli import main
try:
    main()
finally:
    try:
        peak = open("/proc/self/status").read().split("VmHWM:")[1].split()[0]
    except OSError:  # not Linux
        peak = "0"
    print("peak kB:", peak, file=sys.stderr)
"""
"""Runs the command line and prints the peak resident memory of its process, 0 where unknown."""


def commands(device: clradar.Device) -> list[Row]:
    """The two commands whose time and memory are documented, as a user runs them."""
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        hand, sim, volume = (str(Path(folder) / name) for name in ("hand.ply", "sim.h5", "vol.h5"))
        cli = [sys.executable, "-c", PEAK_MEMORY]
        chosen = ["--device", device.info.selector]
        subprocess.run([*cli, "hand", "F", "-o", hand], check=True, capture_output=True)
        for name, arguments in (
            ("simulate the default hand", ["simulate", hand, "-o", sim, *chosen]),
            ("image, 201 x 201 x 81", ["image", sim, "-o", volume, *chosen]),
        ):
            start = time.perf_counter()
            done = subprocess.run([*cli, *arguments], check=True, capture_output=True, text=True)
            seconds = time.perf_counter() - start
            peak_kb = int(done.stderr.split("peak kB:")[1].split()[0])
            memory = f", {peak_kb / 1e6:.2f} GB" if peak_kb else ""
            runs.append(Row(f"clradar {name}", ours=f"{seconds:.1f} s{memory}"))
    return runs
