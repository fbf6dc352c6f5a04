"""A whole body before some clusters: time, processor time and memory of simulation and image.

    python benchmarks/body.py --workers 0 1 2 --samples-per-mm2 0.1
    python benchmarks/body.py --workers 2 --material skin --image

Clusters of the imager, 25 cm apart, and the body of `body_mesh.py` 1.2 m away. Each number of
workers makes the same captures (0: no worker process), whose bytes are compared. Memory is the peak
of the largest process, processor time that of all.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from body_mesh import body_mesh

from measurement_io import open_capture

WALL = """
copy_of = "qar50"
pairs = "cluster"
[[pose]]
plane = {{ size_m = [{width}, {height}], n = [{nx}, {ny}] }}
"""
PITCH_M = 0.25
GRID = ["--x-mm", "-499.5:499.5:3", "--y-mm", "-999:999:3", "--z-mm", "900:1200:3"]


def measured(name: str, *words: object) -> None:
    """Run a command of clradar and print what it took."""
    start_s = perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "clradar", *map(str, words)], stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{name}: exit status {os.waitstatus_to_exitcode(status)}")
    took_s, busy_s = perf_counter() - start_s, used.ru_utime + used.ru_stime
    # Of children, too: those that it waited for.
    print(
        f"{name:34s} {took_s:7.1f} s, {busy_s:7.1f} s of processor time, "
        f"{used.ru_maxrss * _KIB / 1e6:6.0f} MB",
        flush=True,
    )


_KIB = 1 if sys.platform == "darwin" else 1024


def digests(folder: Path) -> tuple[list[str], list[str]]:
    """Of the files of all clusters, and of their samples."""
    files = sorted(folder.glob("cluster_*.h5"))
    contents = [[file.read_bytes(), open_capture(file).data.tobytes()] for file in files]
    whole, samples = (
        [hashlib.sha256(c).hexdigest() for c in column] for column in zip(*contents, strict=True)
    )
    return whole, samples


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faces", type=int, default=1_000_000)
    parser.add_argument("--mesh", type=Path, help="instead of the body made here")
    parser.add_argument("--clusters", type=int, nargs=2, default=(2, 2), metavar=("NX", "NY"))
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 2])
    parser.add_argument("--samples-per-mm2", type=float)
    parser.add_argument("--material", help="for the physical estimator; else expected")
    parser.add_argument("--image", action="store_true", help="image the captures, too")
    given = parser.parse_args()
    os.environ["SOURCE_DATE_EPOCH"] = "0"
    with TemporaryDirectory() as name:
        folder = Path(name)
        mesh = given.mesh
        if mesh is None:
            mesh = folder / "body.ply"
            body_mesh(given.faces).export(mesh)
        nx, ny = given.clusters
        size_m = {"width": PITCH_M * (nx - 1), "height": PITCH_M * (ny - 1)}
        (folder / "wall.toml").write_text(WALL.format(nx=nx, ny=ny, **size_m), encoding="utf-8")
        how = ["--material", given.material] if given.material else ["--estimator", "expected"]
        if given.samples_per_mm2 is not None:
            how += ["--samples-per-mm2", given.samples_per_mm2]
        found = []
        for workers in given.workers:
            words = ["simulate", mesh, "-o", folder / f"by{workers}", "--array"]
            words += [folder / "wall.toml", *how, *(["--workers", workers] if workers else [])]
            measured(f"simulate, {workers} workers", *words)
            found.append(digests(folder / f"by{workers}"))
        whole, samples = (all(f == same[0] for f in same) for same in zip(*found, strict=True))
        print(f"{len(found[0][0])} captures, same files: {whole}, same samples: {samples}")
        if given.image:
            captures = sorted((folder / f"by{given.workers[0]}").glob("cluster_*.h5"))
            measured("image, 334 x 667 x 101", "image", *captures, "-o", folder / "v.h5", *GRID)


if __name__ == "__main__":
    main()
