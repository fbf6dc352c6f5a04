"""The process that reads files: it may die, and can do no harm."""

import io
import multiprocessing
import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import pytest
import reader_probes as probes
from nightly import nightly
from systems import linux_only, posix_only

from clradar.errors import MeasurementError
from clradar.files.confined import process, wire
from measurement_io.confined import reading as confined

ARRAY = '{"\\u0000array": [%s]}'


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "file.h5"
    with h5py.File(target, "w") as file:
        file["x"] = [1, 2]
    return target


def refused(function, path, *arguments, **options):
    with pytest.raises(MeasurementError) as caught:
        confined.run(function, path, *arguments, **options)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    return message


def test_values_and_arrays_come_back_bit_for_bit(path):
    value = [None, True, -1, 2**70, 0.1, "a\n\ud800ü", {"k": [], "array": ["array", 1]}, [[{}]]]
    assert confined.run(probes.same, path, value) == value
    with pytest.raises(TypeError):
        confined.run(probes.same, path, {"\0array": ["<u2", [0]]})
    want = probes.arrays(path)
    have = confined.run(probes.arrays, path, most_bytes=1000)
    assert list(have) == list(want)
    for name, array in want.items():
        assert have[name].shape == array.shape
        assert have[name].dtype == array.dtype or name == "pair"
        assert have[name].tolist() == array.tolist()


def test_a_crash_is_an_error_and_the_next_file_is_read(path):
    assert "crashes" in refused(probes.crash, path)
    assert confined.run(probes.same, path, 1) == 1


def test_an_endless_loop_is_an_error(path, monkeypatch):
    monkeypatch.setattr(confined, "CPU_LIMIT_S", 1)
    assert "more than 1 s" in refused(probes.loop, path)


@linux_only
def test_memory_is_limited(path):
    assert "MemoryError" in refused(probes.take, path, confined.MEMORY_BYTES + 2**24)


def test_the_size_of_results_is_limited(path):
    assert len(confined.run(probes.large, path, 10**6, most_bytes=10**6)) == 10**6
    refused(probes.large, path, 10**6 + 1, most_bytes=10**6)
    refused(probes.large, path, 10**6)


@posix_only
def test_nothing_can_be_written_opened_or_started(path, tmp_path):
    other = tmp_path / "other"
    refused(probes.write, path, str(other))
    assert other.read_text() == ""
    for opens in (probes.open_another, probes.open_after_reading):
        assert "Too many open files" in refused(opens, path, str(other))
    refused(probes.start_a_program, path)


def test_the_folder_is_the_callers(path, monkeypatch):
    monkeypatch.chdir(path.parent)
    assert refused(probes.refuse, Path("file.h5")).startswith("file.h5: ")
    with pytest.raises(MeasurementError, match="nothing there"):
        confined.run(probes.refuse, Path("other.h5"))


@pytest.mark.skipif(not process._FORKS, reason="a process for every file")
def test_another_takes_over(path):
    assert confined.run(probes.same, path, 1) == 1
    other = process._forking._process
    other.kill()
    other.wait()
    assert confined.run(probes.same, path, 2) == 2


@pytest.mark.parametrize("forks", [True, False])
def test_a_process_may_print_and_one_that_does_not_start_is_named(path, monkeypatch, forks):
    monkeypatch.setattr(process, "_FORKS", forks and process._FORKS)
    process._forking.end()
    with monkeypatch.context() as patched:
        patched.setattr(process.sys, "executable", "/bin/false")
        assert "a process to read it in" in refused(probes.same, path, 1)
    (path.parent / "sitecustomize.py").write_text("print('welcome', flush=True)")
    monkeypatch.setenv("PYTHONPATH", str(path.parent))
    assert confined.run(probes.same, path, 2) == 2


def test_threads(path):
    with ThreadPoolExecutor(16) as pool:
        found = pool.map(lambda number: confined.run(probes.same, path, number), range(16))
        assert [*found] == [*range(16)]


def _read_in_a_fork(path):
    return confined.run(probes.same, path, os.getpid()) == os.getpid()


@posix_only
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_forked_processes(path):
    assert confined.run(probes.same, path, 0) == 0
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert all(pool.map(_read_in_a_fork, [path, path], chunksize=1))
    assert confined.run(probes.same, path, 1) == 1


@pytest.mark.parametrize("probe", ["refuse", *nightly(["crash"])])
def test_systems_that_do_not_fork(path, monkeypatch, probe):
    monkeypatch.setattr(process, "_FORKS", False)
    monkeypatch.setattr(process, "_forking", None)  # it is not asked
    monkeypatch.chdir(path.parent)
    want = {"refuse": "file.h5: expected this, got that", "crash": "crashes"}[probe]
    assert want in refused(getattr(probes, probe), Path("file.h5"))


def test_a_process_that_hangs_where_systems_do_not_fork_is_ended(path, monkeypatch):
    monkeypatch.setattr(process, "_FORKS", False)
    monkeypatch.setattr(process, "START_LIMIT_S", -58)  # 2 s, which a busy machine starts it in
    message = refused(probes.wait, path)
    assert "or takes more than 3 s" in message or "got it does not start" in message


def test_a_companion_reads_many_files_opens_none_and_has_successors(path, tmp_path, monkeypatch):
    monkeypatch.setattr(process, "_FORKS", False)
    companion = process.Companion()
    other = tmp_path / "other.bin"
    other.write_bytes(bytes(1000))
    numbers = []
    for file in (path, other):
        content, number = confined.run(probes.content, file, companion=companion)
        assert content.tobytes() == file.read_bytes()
        numbers.append(number)
    message = refused(probes.open_after_reading, path, str(path), companion=companion)
    assert "Too many open files" in message or not process.resource
    assert "crashes" in refused(probes.crash, path, companion=companion)
    copied = pickle.loads(pickle.dumps(companion))
    for each in (companion, copied):
        numbers.append(confined.run(probes.content, path, companion=each)[1])
    assert numbers[0] == numbers[1]  # one process
    assert len(set(numbers)) == 3


# ---- messages of a process that is not to be trusted


def message(header, content=b""):
    return len(header).to_bytes(8, "little") + header.encode() + content


@pytest.mark.parametrize(
    "content",
    [
        b"",
        (2**63).to_bytes(8, "little"),
        message("{"),
        message(ARRAY % '"|O", [1]', bytes(8)),
        message(ARRAY % '"<u2", [2]', bytes(3)),
        message(ARRAY % '"<u2", [-1, -1]', bytes(2)),
        message(ARRAY % '"<u2", [51]', bytes(102)),
        message(ARRAY % '"<u2", [4294967296, 4294967296]', bytes(102)),
        message("[" * 100_000),
    ],
    ids=range(9),
)
def test_messages_that_are_none(content):
    with pytest.raises(wire.BrokenMessage):
        wire.receive(io.BytesIO(content), 100)
