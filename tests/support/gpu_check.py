"""What compilers for GPUs make of the kernels: registers, stack, spills, byte loads, occupancy.

`make gpucheck` installs the compilers, prints the table and fails where it differs from
``gpu_table.json`` or misses a goal; ``--write`` writes that file. No GPU is needed. Clang compiles
every kernel in its one-lane form to PTX, which ptxas assembles, and to AMD's machine code.
"""

import importlib.util
import json
import math
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clradar.geometry.bvh import TraversalOptions
from clradar.hand.flesh import _FleshOptions
from clradar.imaging.direct_sum import _Sizes
from clradar.imaging.exact import ExactImager, ExactSizes
from clradar.imaging.range_profiles import RangeImager
from clradar.imaging.samples import SampleSizes
from clradar.imaging.strongest import DepthSizes
from clradar.imaging.tiled import KernelSizes
from clradar.imaging.tree_on_device import _ForwardSizes, _KernelSizes, _SumSizes, groups_of_leaf
from clradar.opencl.program import _Width, defines
from clradar.opencl.sources import source
from clradar.phasors.kirchhoff_sum import KirchhoffOptions
from clradar.phasors.phasor_sum import SynthesizeOptions
from clradar.tracing.antenna_packets import VisibilityOptions
from clradar.tracing.expected import ExpectedOptions
from clradar.tracing.quadrature import QuadratureOptions, RoughnessOptions
from clradar.tracing.sampled_surface import SampleOptions
from clradar.tracing.stochastic import OrderOptions, TraceOptions

BUILTINS = Path(__file__).with_name("gpu_builtins.h")
TABLE = Path(__file__).with_name("gpu_table.json")

TRAVERSAL: dict[str, Any] = {"wide": False, "stack": 8}
"""Of the default hand."""

_BLOCKS: dict[str, Any] = {"width": 1, "leaf": 16, "far": False, "points": False}

PROGRAMS: dict[str, Any] = {
    "nearest.cl": TraversalOptions(width=1, **TRAVERSAL),
    "visibility.cl": VisibilityOptions(width=1, **TRAVERSAL),
    "sample.cl": SampleOptions(width=1),
    "trace.cl": TraceOptions(width=1, **TRAVERSAL, spreading=True),
    "receptions.cl": OrderOptions(width=1),
    "expected.cl": ExpectedOptions(width=1, spreading=True),
    "synthesize.cl": SynthesizeOptions(width=1, in_parts=True, pairs=1),
    "backproject_exact.cl": ExactSizes(width=1, rx_chunk=ExactImager.gpu_rx_chunk),
    "backproject_range.cl": KernelSizes(width=1, rx_chunk=RangeImager.gpu_rx_chunk),
    "tree_sums.cl": _SumSizes(width=1, rows=96, far=False),
    "backproject_fast.cl": _KernelSizes(**_BLOCKS, kept=16),
    "forward_fast.cl": _ForwardSizes(**_BLOCKS, groups=groups_of_leaf(_BLOCKS["leaf"])),
    "samples.cl": SampleSizes(width=1),
    "depth.cl": DepthSizes(width=1),
    "direct_sum.cl": _Sizes(width=1),
    "quadrature.cl": QuadratureOptions(width=1),
    "roughness.cl": RoughnessOptions(width=1),
    "kirchhoff.cl": KirchhoffOptions(width=1, terms=2, materials=True, pattern=False),
    "flesh.cl": _FleshOptions(width=1, palm=5, root=3, end=3),
    "self_test.cl": _Width(width=1),
}
"""The options of a simulation of the default hand and of the paper's image on a GPU."""

NVIDIA = ("sm_70", "sm_80", "sm_90")
AMD = {"gfx90a": 8, "gfx1100": 16}
"""Most wavefronts of a SIMD."""


@dataclass(frozen=True, slots=True)
class Use:
    """What a kernel takes of a GPU: registers of an item (vector registers on AMD's), bytes of an
    item in local memory and how many of these are spilled registers, instructions that load a
    single byte, percent of the items that a processor can hold by registers."""

    registers: int
    stack: int
    spills: int
    byte_loads: int
    occupancy: int


def missing() -> str | None:
    """What is not installed of the compilers, and how to get it; None if all is there."""
    for module in ("ziglang", "nvidia.cuda_nvcc"):
        try:
            found = importlib.util.find_spec(module)
        except ModuleNotFoundError:
            found = None
        if found is None:
            return f"no {module} here: `make gpucheck` installs clang and ptxas from PyPI"
    return None


def check_all() -> dict[str, dict[str, Use]]:
    """What each kernel takes, by its name and by target."""
    kernels: dict[str, dict[str, Use]] = {}
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(check, PROGRAMS):
            kernels |= found
    return kernels


def check(file: str) -> dict[str, dict[str, Use]]:
    """What each kernel of a file takes, by its name and by target."""
    kernels: dict[str, dict[str, Use]] = {}
    with tempfile.TemporaryDirectory() as folder:
        ptx = _compiled(file, "nvptx64-nvidia-cuda", NVIDIA[0], Path(folder))
        most = getattr(PROGRAMS[file], "nvidia_registers", None)
        by_target = {target: _nvidia_uses(ptx, target, most, Path(folder)) for target in NVIDIA}
        for target, most_waves in AMD.items():
            assembly = _compiled(file, "amdgcn-amd-amdhsa", target, Path(folder))
            by_target[target] = _amd_uses(assembly, most_waves)
    for target, uses in by_target.items():
        for kernel, use in uses.items():
            kernels.setdefault(kernel, {})[target] = use
    return kernels


def _compiled(file: str, triple: str, target: str, folder: Path) -> str:
    kernel_file, assembly = folder / file, folder / "out.s"
    kernel_file.write_text(source(file), encoding="utf-8")
    _run(
        sys.executable, "-m", "ziglang", "clang", "-x", "cl", "-cl-std=CL1.2", "-cl-no-stdinc",
        "-nogpulib", "-include", str(BUILTINS), f"--target={triple}", "-O3", "-S",
        "-Xclang", "-target-cpu", "-Xclang", target, *defines(PROGRAMS[file]),
        str(kernel_file), "-o", str(assembly),
    )  # fmt: skip
    return assembly.read_text(encoding="utf-8")


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    return done.stderr


def _ptxas() -> str:
    import nvidia.cuda_nvcc

    return str(Path(next(iter(nvidia.cuda_nvcc.__path__))) / "bin" / "ptxas")


def _nvidia_uses(ptx: str, target: str, most: int | None, folder: Path) -> dict[str, Use]:
    (folder / "in.ptx").write_text(ptx, encoding="utf-8")
    limit = [] if most is None else [f"--maxrregcount={most}"]
    said = _run(
        _ptxas(), "-v", f"-arch={target}", *limit, "-c", str(folder / "in.ptx"),
        "-o", str(folder / "out"),
    )  # fmt: skip
    code = {
        part.split("(")[0].strip(): part
        for part in re.split(r"^\.visible \.entry ", ptx, flags=re.MULTILINE)[1:]
    }
    uses = {}
    for part in said.split("Compiling entry function ")[1:]:
        kernel = part.split("'")[1]
        (registers,) = _numbers(r"Used (\d+) registers", part)
        stack, stores, _ = _numbers(
            r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", part
        )
        # A quarter of a multiprocessor has 16384 registers, given out to 32 items by 256.
        warps = min(16, 16384 // (32 * 8 * math.ceil(registers / 8)))
        bytes_loaded = len(re.findall(r"\bld(?:\.\w+)*\.[usb]8\b", code[kernel]))
        uses[kernel] = Use(registers, stack, stores, bytes_loaded, round(100 * warps / 16))
    return uses


def _amd_uses(assembly: str, most_waves: int) -> dict[str, Use]:
    uses = {}
    for part in assembly.split("-- Begin function ")[1:]:
        kernel = part.split()[0]
        if "; Kernel info:" not in part:
            continue  # a function
        (waves,) = _numbers(r"; Occupancy: (\d+)", part)
        of = rf"^    \.name: +{kernel}\n(?:    .*\n)*?    \."
        stack, registers, spilled = (
            _numbers(rf"{of}{name}: +(\d+)", assembly)[0]
            for name in ("private_segment_fixed_size", "vgpr_count", "vgpr_spill_count")
        )
        code = part.split(".section")[0]
        bytes_loaded = len(re.findall(r"_load_\w*(?:ubyte|sbyte|[ui]8)\b", code))
        occupancy = round(100 * waves / most_waves)
        uses[kernel] = Use(registers, stack, 4 * spilled, bytes_loaded, occupancy)
    return uses


def _numbers(pattern: str, text: str) -> list[int]:
    match = re.search(pattern, text, flags=re.MULTILINE)
    if match is None:
        raise RuntimeError(f"expected {pattern!r} in what the compiler said, got:\n{text[:2000]}")
    return [int(group) for group in match.groups()]


def read_table() -> dict[str, dict[str, Use]]:
    """The table in the repository."""
    columns = json.loads(TABLE.read_text(encoding="utf-8"))
    return {
        kernel: {target: Use(*numbers) for target, numbers in row.items()}
        for kernel, row in columns.items()
    }


def write_table(kernels: dict[str, dict[str, Use]]) -> None:
    """Write the table: a line for each kernel, in a target the numbers of `Use` in their order."""
    rows = (
        f"  {json.dumps(kernel)}: "
        + json.dumps({target: list(asdict(use).values()) for target, use in row.items()})
        for kernel, row in sorted(kernels.items())
    )
    TABLE.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def main() -> None:
    lack = missing()
    if lack:
        sys.exit(lack)
    kernels = check_all()
    names = list(Use.__dataclass_fields__)
    print(f"{'kernel':<24}{'target':<9}" + "".join(f"{name:>12}" for name in names))
    for kernel, row in sorted(kernels.items()):
        for target, use in row.items():
            print(f"{kernel:<24}{target:<9}" + "".join(f"{n:>12}" for n in asdict(use).values()))
    if "--write" in sys.argv[1:]:
        write_table(kernels)
    elif kernels != read_table():
        sys.exit(f"differs from {TABLE}: if that is meant, `make gpucheck GPUCHECK=--write`")


if __name__ == "__main__":
    main()
