"""The device layer: which device, builds and memory."""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from importlib.metadata import PackagePath
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from nightly import nightly

import clradar
from clradar.errors import DeviceError, ModelError
from clradar.imaging.strongest import DepthSizes
from clradar.opencl import (
    Buffers,
    DeviceInfo,
    build,
    choice,
    cpu_beside,
    device as device_module,
    list_devices,
    open_device,
    program as program_module,
    runtimes,
)
from clradar.opencl.buffers import OnDevice
from clradar.opencl.choice import chosen_device
from clradar.opencl.program import launch_parts, self_test
from clradar.opencl.sources import source

# Which device ------------------------------------------------------------------------------------


def info(
    selector: str, name: str, platform: str, kind: str = "cpu", memory_bytes: int = 2**30
) -> DeviceInfo:
    return DeviceInfo(selector, name, platform, "OpenCL 1.2", kind, memory_bytes, 2**28, 2)


OCLGRIND = info("0:0", "Oclgrind Simulator", "Oclgrind", "gpu")
POCL = info("1:0", "cpu-Intel(R) Xeon(R)", "Portable Computing Language")
INTEL = info("2:0", "Intel(R) Xeon(R)", "Intel(R) OpenCL")
CARD = info("3:0", "NVIDIA H100", "NVIDIA CUDA", "gpu")
CARD_2 = info("3:1", "NVIDIA A100", "NVIDIA CUDA", "gpu")
OTHER = info("4:0", "Board", "Accelerators", "other")


def raising(error: Exception) -> Callable[..., None]:
    """A function that fails so."""

    def fail(*_: Any, **__: Any) -> None:
        raise error

    return fail


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Pretend that the machine has these devices, and that no variable chooses one."""
    monkeypatch.delenv("CLRADAR_DEVICE", raising=False)
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    fault = choice.fault.__wrapped__  # which remembers nothing
    why = (
        "self_test.cl does not build (error: unknown target CPU 'generic'); choose; the log:\nmore"
    )

    def pretend(*infos: DeviceInfo, failing: Sequence[DeviceInfo] = ()) -> None:
        said = [DeviceError(f"device {info.label}: {why}") for info in failing]
        errors = {info.selector: raising(error) for info, error in zip(failing, said, strict=True)}
        monkeypatch.setattr(device_module, "_found", lambda: [(i, None) for i in infos])
        monkeypatch.setattr(choice, "opened", lambda selector, *_: selector)
        monkeypatch.setattr(choice, "self_test", lambda selector: errors.get(selector, id)(0))
        monkeypatch.setattr(choice, "fault", fault)
        monkeypatch.setattr(choice, "_told", set())

    return pretend


@pytest.mark.parametrize(
    ("infos", "chosen"),
    [
        ((OCLGRIND, POCL, INTEL), INTEL),
        ((OCLGRIND, POCL, INTEL, CARD, CARD_2), CARD),
        ((OCLGRIND, OTHER, POCL), POCL),
        ((OCLGRIND, OTHER), OTHER),
    ],
)
def test_none_means_gpu_then_intel_then_pocl_never_the_checker(machine, infos, chosen):
    machine(*infos)
    assert chosen_device() == chosen
    machine(*infos[::-1])
    assert chosen_device().platform == chosen.platform


EVERYTHING = (OCLGRIND, POCL, INTEL, CARD, CARD_2)


@pytest.mark.parametrize(
    ("wanted", "chosen"),
    [
        (" PoCL ", POCL), ("Portable Computing Language", POCL), ("a100", CARD_2), ("gpu", CARD),
        ("cpu", POCL), ("3:1", CARD_2), ("3", CARD), ("0:0", OCLGRIND), ("nvidia:a100", CARD_2),
    ],
)  # fmt: skip
@pytest.mark.parametrize("variable", ["CLRADAR_DEVICE", "PYOPENCL_CTX"])
def test_a_device_is_chosen_by_name_kind_or_index(machine, monkeypatch, variable, wanted, chosen):
    machine(*EVERYTHING)
    monkeypatch.setenv(variable, wanted)
    assert chosen_device() == chosen
    monkeypatch.setenv("CLRADAR_DEVICE", "oclgrind")  # goes before the other
    assert chosen_device() == OCLGRIND


WHY = r"self_test.cl does not build \(error: unknown target CPU 'generic'\)"


@pytest.mark.parametrize(
    ("wanted", "failing", "chosen"),
    [
        (None, (CARD, CARD_2), INTEL),
        ("gpu", (CARD,), CARD_2),
        ("cpu", (POCL,), INTEL),
    ],
)
def test_of_several_devices_the_first_that_works_is_used_and_the_others_are_named_once(
    machine, monkeypatch, wanted, failing, chosen
):
    machine(*EVERYTHING, failing=failing)
    if wanted is not None:
        monkeypatch.setenv("CLRADAR_DEVICE", wanted)
    with pytest.warns(clradar.ClradarWarning) as caught:
        assert chosen_device() == chosen
    for info, one in zip(failing, caught, strict=True):
        start = re.escape(f"device {info.selector} {info.label}")
        instead = re.escape(f"{chosen.label} is used instead")
        assert re.fullmatch(f"{start} {WHY}; {instead}.*", str(one.message))  # one line
    assert chosen_device() == chosen  # without a word


def test_all_devices_are_those_that_would_be_used(machine, monkeypatch):
    """All GPUs, each by one driver; else those like the default one."""
    by_another_driver = replace(CARD, selector="5:0", platform="Mesa")
    machine(*EVERYTHING, by_another_driver)
    assert choice.select_devices("all") == [CARD, CARD_2]
    twice = replace(POCL, selector="1:1")
    machine(POCL, twice)
    assert choice.select_devices("all") == [POCL, twice]
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    assert choice.select_devices(None) == [POCL, twice]
    monkeypatch.delenv("CLRADAR_DEVICE")
    machine(*EVERYTHING, failing=(CARD, CARD_2))
    with pytest.warns(clradar.ClradarWarning, match="is used instead"):
        assert choice.select_devices("all") == [INTEL]
    machine(*EVERYTHING, failing=(POCL,))
    assert choice.select_devices("pocl") == [POCL]  # one that is named is not exchanged


HERE = re.escape(f"expected one of the devices here (0:0 {OCLGRIND.label}; 1:0 {POCL.label})")


@pytest.mark.parametrize(
    ("infos", "failing", "wanted", "message"),
    [
        *(
            ((OCLGRIND, POCL), (), wanted, f"device: {HERE}.*got {wanted!r}.*pip install")
            for wanted in ("vivante", "7:0", "1:3", "", ":", "gpu", "1:0:0")
        ),
        ((OCLGRIND,), (), None, r"no OpenCL device but a memory checker.*pip install"),
        (
            EVERYTHING, EVERYTHING, None,
            rf"no OpenCL device works: 3:0 .* {WHY}; 3:1 .*conda-forge.*5\.0 on.*docs/install\.md",
        ),
    ],
)  # fmt: skip
def test_where_none_can_be_opened_the_error_has_the_reasons_and_the_ways_out(
    machine, infos, failing, wanted, message
):
    machine(*infos, failing=failing)
    with pytest.raises(DeviceError, match=message):
        open_device(wanted)


def test_without_opencl_the_error_names_a_remedy(monkeypatch):
    for platforms, words in (
        (list, "no OpenCL device was found; install .*pip install"),
        (raising(cl.LogicError("NOT_FOUND")), "no OpenCL platform was found .*NOT_FOUND.*install"),
    ):
        monkeypatch.setattr(cl, "get_platforms", platforms)
        with pytest.raises(DeviceError, match=words):
            list_devices()


def test_environment_chooses_for_every_function(device, monkeypatch):
    monkeypatch.setenv("CLRADAR_DEVICE", device.info.selector)
    known = open_device()  # the fixture's may be forgotten, as after a sample that failed
    assert known is open_device(known) is open_device(device.info.selector)
    assert device.info == known.info in list_devices()
    monkeypatch.setenv("CLRADAR_DEVICE", "no such device")
    paths = clradar.Paths([0], [0], [0.6], [1.0], [1], 1, 1)
    given = (paths, clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]]), clradar.Waveform([1e9]))
    with pytest.raises(DeviceError, match="CLRADAR_DEVICE: expected one of the devices here"):
        clradar.synthesize(*given)
    assert clradar.synthesize(*given, device=device).meta["device"]["device"]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"device": 3}, DeviceError, r"expected a clradar\.Device, a string or None, got int"),
        ({"memory_limit_bytes": 0}, ModelError, "a whole number >= 1, got 0"),
        ({"width": 4}, ModelError, "1 or 8 lanes per work-item, got 4"),
    ],
)
def test_open_device_refuses(arguments, error, message):
    with pytest.raises(error, match=message):
        open_device(**arguments)


def test_a_memory_limit_only_lowers_the_budget(device):
    assert device.budget_bytes == int(device.info.memory_bytes * device_module.MEMORY_SHARE)
    small = open_device(device.info.selector, memory_limit_bytes=10**6)
    assert small.budget_bytes == small.max_buffer_bytes == 10**6
    large = open_device(device.info.selector, memory_limit_bytes=10**18)
    assert large.budget_bytes == device.budget_bytes
    with pytest.raises(DeviceError, match="for which they are settled"):
        open_device(device, memory_limit_bytes=10**6)


@pytest.mark.skipif(os.name != "posix", reason="the folder of the cache is elsewhere")
def test_a_home_that_cannot_be_written_hides_no_device(tmp_path):
    home = tmp_path / "a file"
    home.touch()
    code = (
        "import clradar; from clradar.opencl.choice import fault; "
        "print(fault(clradar.open_device('pocl').info.selector))"
    )
    environment = {k: v for k, v in os.environ.items() if k != "XDG_CACHE_HOME"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True,
        env={**environment, "HOME": str(home), "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert done.stdout == "None\n", done.stderr
    assert "cannot be written" in done.stderr
    assert "set XDG_CACHE_HOME" in done.stderr
    assert sorted(tmp_path.iterdir()) == [home]


# Memory ------------------------------------------------------------------------------------------


@pytest.fixture
def small(device: clradar.Device) -> clradar.Device:
    return open_device(device.info.selector, memory_limit_bytes=4096)


def test_a_buffer_is_of_its_block_alone(small):
    with Buffers(small) as buffers:
        held = buffers.upload(np.ones(3))
    for use in (
        lambda: buffers.read(held, 3, np.float64),
        lambda: buffers.write(held, np.ones(3)),
        lambda: buffers.release(held),
    ):
        with pytest.raises(DeviceError, match="expected a buffer of this block, got one that was"):
            use()
    with pytest.raises(DeviceError, match="inside the `with` block, got one after"):
        buffers.empty(16)


def test_an_allocation_beyond_the_budget_names_device_and_remedy(small):
    label = re.escape(small.info.label)
    with Buffers(small) as buffers:
        buffers.empty(1024)
        for size in (4097 - 1024, 2**50):
            with pytest.raises(
                DeviceError, match=rf"^device {label}: a buffer of .*does not fit.*CLRADAR_DEVICE="
            ):
                buffers.empty(size)
        assert buffers.used_bytes == 1024
        buffers.empty(3072)  # exactly full


@pytest.mark.parametrize(
    ("owner", "name", "error"),
    [
        (cl, "Buffer", cl.MemoryError("MEM_OBJECT_ALLOCATION_FAILURE")),
        (np, "empty", MemoryError("no more of it")),  # of a CPU's large buffers
    ],
)
def test_an_allocation_that_is_refused_names_device_and_remedy(
    device, monkeypatch, owner, name, error
):
    said = f"8.0 MiB could not be allocated .*{error}.*CLRADAR_DEVICE="
    with Buffers(device) as buffers:
        monkeypatch.setattr(owner, name, raising(error))
        with pytest.raises(DeviceError, match=f"^device {re.escape(device.info.label)}: {said}"):
            buffers.empty(2**23)


def test_all_buffers_of_a_device_share_its_budget(small):
    with Buffers(small) as first, Buffers(small) as second:
        first.empty(3000)
        assert (second.used_bytes, second.free_bytes) == (0, 1096)
        with pytest.raises(DeviceError, match=r"does not fit \(0\.0 MiB of 0\.0 MiB in use"):
            second.empty(1200)
        second.empty(1096)
        first.close(waiting=False)
        assert second.free_bytes == 3000


def test_after_an_exception_memory_is_freed_when_nothing_uses_it(small, monkeypatch):
    class Prepared(OnDevice):
        def _prepare(self) -> None:
            self._buffers.empty(16)

    order: list[str] = []
    queue = SimpleNamespace(finish=lambda: order.append("finish"))
    block = Prepared(replace(small, queue=queue))

    class Recorded(cl.Buffer):
        def release(self) -> None:
            order.append("release")

    monkeypatch.setattr(cl, "Buffer", Recorded)

    def interrupted() -> None:
        with block:
            block._buffers.empty(16)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert order == ["finish", "release", "release"]


# Threads and processes ---------------------------------------------------------------------------


def test_threads_that_use_a_device_at_once_get_their_own_results(device):
    """Programs, with the arguments of their kernels, belong to the device."""
    array = clradar.AntennaArray(np.eye(3)[:2] * 0.02, np.eye(3) * 0.03)
    waveform = clradar.Waveform.sfcw(72e9, 82e9, 4)
    corners = np.array([[-0.02, -0.02, 0.3], [0.02, -0.02, 0.3], [0.0, 0.03, 0.31]])

    def simulated(i: int) -> bytes:
        scene = clradar.Scene(corners + 0.002 * i, [[0, 1, 2]], 1.0)
        return clradar.simulate(
            scene, array, waveform, estimator=("expected", "stochastic")[i % 2], rays_per_face=50,
            reception_radius_m=0.1, device=device,
        ).data.tobytes()  # fmt: skip

    expected = [simulated(i) for i in range(6)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(simulated, list(range(6)) * 4))
    finally:
        sys.setswitchinterval(interval)
    assert found == expected * 4


FORK = """
import os, sys
import clradar, clradar.errors
import numpy as np
capture = clradar.Capture(
    np.ones((1, 1, 1)), clradar.AntennaArray([[0, 0, 0]], [[0, 0, 0]]), clradar.Waveform([1e9])
)
grid = clradar.VoxelGrid.from_extent((0, 0), (0, 0), (1, 1), 1)
device = clradar.open_device("pocl")
if sys.argv[1] == "used":
    clradar.backproject(capture, grid, device=device)
child = os.fork()
if not child:
    for call in (
        lambda: clradar.open_device("pocl"),
        clradar.list_devices,
        lambda: clradar.backproject(capture, grid, device=device),
    ):
        try:
            call()
        except clradar.errors.DeviceError as error:
            print(error, flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
clradar.backproject(capture, grid, device=device)  # which goes on here
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize("before", ["used", *nightly(["opened"])])
def test_a_fork_of_a_process_with_devices_gets_an_error_that_says_what_to_do(before):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORK, before], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    for line in lines:
        assert "OpenCL hangs" in line
        assert "get_context('spawn')" in line
        assert "DataLoader(multiprocessing_context='spawn')" in line


# Programs ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Options:
    factor: float = 2.0
    negate: bool = False


KERNEL = """
__kernel void scale(__global float *x) {
    const int i = (int)get_global_id(0);
    x[i] = (CLR_NEGATE ? -1.0f : 1.0f) * CLR_FACTOR * x[i];
}
"""


def test_a_cpu_beside_a_gpu_is_one_that_works(device, machine, monkeypatch):
    gpu = replace(device, info=CARD)
    machine(CARD, POCL, INTEL)
    assert cpu_beside(gpu) == INTEL.selector
    machine(CARD, POCL, INTEL, failing=(INTEL,))
    with pytest.warns(clradar.ClradarWarning, match=rf"{WHY}; cpu-Intel.* is used instead"):
        assert cpu_beside(gpu) == POCL.selector
    machine(CARD, POCL, failing=(POCL,))
    with pytest.warns(clradar.ClradarWarning, match=rf"{WHY}; numpy is used instead"):
        assert cpu_beside(gpu) is None
    assert cpu_beside(gpu) is None  # without a word


@pytest.fixture
def kernel_text(monkeypatch: pytest.MonkeyPatch, device: clradar.Device) -> Iterator[Callable]:
    """Replace every kernel file by a text."""
    self_test(device)
    known = dict(device.programs)

    def use(text: str) -> None:
        monkeypatch.setattr(program_module, "source", lambda _: text)

    yield use
    device.programs.clear()
    device.programs.update(known)


def test_a_damaged_cache_of_pyopencl_is_no_error(device, kernel_text, monkeypatch):
    """What another processor has left there does not load: "INVALID_BINARY"."""
    broken = raising(RuntimeError("clCreateProgramWithBinary failed: INVALID_BINARY"))
    monkeypatch.setattr("pyopencl.cache._create_built_program_from_source_cached", broken)
    kernel_text(KERNEL)
    assert list(build(device, "scale.cl", Options(5.0)).kernels) == ["scale"]


def test_a_build_error_has_device_options_and_log(device, kernel_text):
    kernel_text("__kernel void broken(__global float *x) { x[0] = no_such_name; }")
    with pytest.raises(DeviceError) as caught:
        build(device, "broken.cl", Options(negate=True))
    message = str(caught.value)
    assert message.startswith(f"device {device.info.label}: broken.cl does not build (")
    for part in ("-DCLR_FACTOR=2", "-DCLR_NEGATE=1", "CLRADAR_DEVICE=", "no_such_name"):
        assert part in message  # options, what to do, the compiler's log


def test_the_last_axes_of_launches_are_cut_first():
    starts = [at for at, _ in launch_parts((128, 2), (64, 1), 70)]
    assert starts == [(0, 0), (0, 1), (64, 0), (64, 1)]


def test_a_launch_that_fails_names_device_kernel_and_remedy(device, kernel_text, monkeypatch):
    error, words = cl.MemoryError("OUT_OF_RESOURCES"), "out of memory in kernel scale of scale.cl"
    kernel_text(KERNEL)
    program = build(device, "scale.cl", Options())
    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", raising(error))
    label = re.escape(device.info.label)
    with (
        Buffers(device) as buffers,
        pytest.raises(DeviceError, match=f"^device {label}: .*{words}.*{error}.*CLRADAR_DEVICE="),
    ):
        program.launch("scale", (7,), buffers.zeros(28))


@pytest.mark.parametrize(
    ("exact", "changed", "flags", "wrong"),
    [
        ("(b.hi - square)", "fma(-root, root, b.hi)", [], "length of a vector"),  # contracted
        ("", "", ["-cl-fast-relaxed-math"], "product of "),  # reordered
    ],
)
def test_a_device_that_changes_exact_arithmetic_is_refused(
    monkeypatch, exact, changed, flags, wrong
):
    device = replace(open_device("pocl"), programs={})
    options = DepthSizes(device.width)
    with monkeypatch.context() as patched:
        assert exact in source("self_test.cl")
        text = source("self_test.cl").replace(exact, changed)
        patched.setattr(program_module, "source", lambda _: text)
        patched.setattr(program_module, "_gpu_flags", lambda *_: flags)
        for _ in range(2):
            with pytest.raises(DeviceError) as caught:
                build(device, "depth.cl", options)
            message = str(caught.value)
            assert message.startswith(f"device {device.info.label}, driver {device.info.version}: ")
            assert wrong in message
    assert list(build(device, "depth.cl", options).kernels) == ["strongest_along_z"]


# Intel's runtime


def test_intel_library_is_found_in_its_package(monkeypatch, tmp_path):
    path = PackagePath("lib/libintelocl.so")
    path.dist = SimpleNamespace(locate_file=lambda path: tmp_path / path)
    monkeypatch.setattr(runtimes, "distribution", lambda _: SimpleNamespace(files=[path]))
    assert runtimes.intel_library() is None  # listed, but deleted
    (tmp_path / "lib").mkdir()
    (tmp_path / path).touch()
    assert runtimes.intel_library() == (tmp_path / path).resolve()


@pytest.fixture
def listed(monkeypatch, tmp_path):
    """Entries that the loader sees at each listing of platforms, of which this is the first."""
    seen = []

    def get_platforms():
        folder = os.environ.get("OCL_ICD_VENDORS")
        entries = {} if folder is None else {p.name: p.read_text() for p in Path(folder).iterdir()}
        seen.append(entries)
        return []

    for name in runtimes.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(runtimes, "_listed", False)
    monkeypatch.setattr(runtimes.cl, "get_platforms", get_platforms)
    monkeypatch.setattr(runtimes, "SYSTEM_VENDORS", tmp_path / "vendors")
    return seen


def test_intel_runtime_is_added_to_the_systems(listed, monkeypatch, tmp_path):
    runtimes.SYSTEM_VENDORS.mkdir()
    (runtimes.SYSTEM_VENDORS / "gpu.icd").write_text("libgpu.so.1")
    # One that the system knows would be there twice.
    (runtimes.SYSTEM_VENDORS / "intel.icd").write_text("/opt/libintelocl.so")
    library = tmp_path / "libintelocl.so"
    monkeypatch.setattr(runtimes, "intel_library", lambda: library)
    runtimes.platforms()
    assert listed == [{"gpu.icd": "libgpu.so.1", "clradar-intel.icd": f"{library}\n"}]
    assert "OCL_ICD_VENDORS" not in os.environ
    runtimes.platforms()  # the loader has read its list
    assert listed[1:] == [{}]


def test_intel_runtime_is_added_on_windows(listed, monkeypatch, tmp_path):
    library, path = tmp_path / "intelocl64.dll", os.environ["PATH"]
    monkeypatch.setenv("PATH", path)  # put back at the end
    monkeypatch.setattr(runtimes, "intel_library", lambda: library)
    named = []
    monkeypatch.setattr(
        runtimes.cl, "get_platforms", lambda: named.append(os.environ["OCL_ICD_FILENAMES"]) or []
    )
    runtimes.platforms()
    assert named == [str(library)]
    assert "OCL_ICD_FILENAMES" not in os.environ
    assert os.environ["PATH"] == f"{tmp_path}{os.pathsep}{path}"  # of what it needs later


def test_platforms_chosen_by_the_environment_are_kept(listed, monkeypatch, tmp_path):
    monkeypatch.setattr(runtimes, "intel_library", lambda: tmp_path / "libintelocl.so")
    chosen = tmp_path / "chosen"
    chosen.mkdir()
    monkeypatch.setenv("OCL_ICD_VENDORS", str(chosen))
    runtimes.platforms()
    assert listed == [{}]
    assert os.environ["OCL_ICD_VENDORS"] == str(chosen)
