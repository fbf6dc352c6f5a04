"""Batches over several devices, on PoCL that shows the CPU twice."""

import re

import pytest
from two_devices import N, findings_of

from clradar.cli.commands.devices import command
from clradar.errors import DeviceError
from clradar.jobs import Where
from clradar.opencl import Device, DeviceInfo, choice, device, open_device


def test_results_come_in_order_from_both(tmp_path):
    found = findings_of("batches", tmp_path)
    assert [number for number, _ in found["made"]] == list(range(N))
    assert sorted({selector for _, selector in found["made"]}) == ["0:0", "0:1"]
    assert found["warned"] == ["each says this"]
    assert found["shown"] == [[i + 1, N] for i in range(N)]
    assert "expected devices, each once, got 0:0" in found["twice"]
    assert "expected one device, got 'all'" in found["single"]


@pytest.mark.device
def test_errors_of_workers_name_the_device(monkeypatch):
    workers = pytest.importorskip("clradar.jobs.workers")
    monkeypatch.setenv("CLRADAR_DEVICE", "pocl")

    def full(item: int, device: Device, progress: object) -> None:
        raise DeviceError(f"device {device.info.label}: out of memory")

    error, _ = workers.run_item(full, 0, None)
    own = open_device().info
    assert str(error) == f"device {own.selector} {own.label}: out of memory"


@pytest.mark.slow
def test_a_process_that_dies_is_named_with_its_item(tmp_path):
    found = findings_of("killed", tmp_path)
    assert re.match(r"DeviceError: device 0:1 .* its process died at item", found)


def listed(selector: str, name: str, kind: str) -> DeviceInfo:
    return DeviceInfo(selector, name, f"platform {selector[0]}", "1", kind, 2**30, 2**30, 4)


def test_the_list_marks_all_that_would_be_used(monkeypatch, capsys):
    there = [(listed(f"0:{i}", "A", "cpu"), None) for i in range(2)]
    monkeypatch.setattr(device, "_found", lambda: there)
    monkeypatch.setattr(choice, "_failure", lambda selector: None)
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    command()
    out = capsys.readouterr().out
    assert out.count("*") == 2
    assert out.endswith("used: 0:0 A [platform 0], 0:1 A [platform 0]\n")


@pytest.mark.device
def test_devices_of_two_kinds_are_not_alike():
    devices = Where("pocl")
    devices.__dict__["infos"] = (devices.first.info, listed("1:0", "B", "gpu"))
    with pytest.raises(DeviceError, match=r"one name and driver for a sweep.*1:0 B"):
        devices.check_alike("a sweep")
