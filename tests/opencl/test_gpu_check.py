"""The kernels: their options, and the table of what they take of a GPU, compared with the goals."""

import re

import gpu_check

from clradar.opencl.sources import kernel_folder

TABLE = gpu_check.read_table()

HOT = {
    "visible_antennas", "visible_spheres", "nearest_hits", "draw_rays", "trace_rays",
    "receive_rays", "bounce_rays", "order_receptions", "reception_probabilities",
    "listed_probabilities", "expected_paths", "add_paths", "finish", "block_phasors",
    "reduce_and_transpose", "reduce_rows", "reduce_frequencies", "image_of_blocks",
    "voxels_of_blocks",
}  # fmt: skip
MOST_REGISTERS = 96
MOST_STACK = 256
KEPT_BYTES = {"blocks_of_voxels": 4352}
"""Phasors of a block's antennas to 16 voxels, which one loop makes and the next takes."""

READ_BYTES = {"legs": 1, "receiver_discs": 1, "sides_seen": 1, "draw_rays": 1, "tx_lobes": 1}
"""Loads of buffers of bytes: visible antennas, eight to a byte, and media."""

ON_CPUS_ALONE = {"split_nodes"}


def test_the_tables_have_every_kernel():
    files = {file.name: file.read_text(encoding="utf-8") for file in kernel_folder().glob("*.cl")}
    assert {*gpu_check.PROGRAMS, "build.cl"} == set(files)
    defined = re.findall(r"__kernel\s+void\s+(\w+)", "".join(files.values()))
    assert set(defined) - ON_CPUS_ALONE == set(TABLE)


def misses(kernel: str) -> list[str]:
    """The goals that a kernel misses."""
    uses, found = TABLE[kernel].values(), []
    if any(use.byte_loads > READ_BYTES.get(kernel, 0) for use in uses):
        found.append("byte loads")
    if any(use.spills for use in uses):
        found.append("spills")
    if any(use.stack > KEPT_BYTES.get(kernel, MOST_STACK) for use in uses):
        found.append("stack")
    # AMD's compiler takes what the occupancy leaves it.
    if kernel in HOT and any(
        TABLE[kernel][on].registers > MOST_REGISTERS for on in gpu_check.NVIDIA
    ):
        found.append("registers")
    return found


def test_goals():
    assert {kernel: found for kernel in TABLE if (found := misses(kernel))} == {}
