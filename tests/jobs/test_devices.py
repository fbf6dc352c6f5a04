"""Batches over several devices, on PoCL that shows the CPU twice."""

from dataclasses import replace
from typing import Any

import pytest
from two_devices import N, findings_of

from clradar.cli.commands.devices import command
from clradar.errors import DeviceError
from clradar.jobs import Where
from clradar.opencl import DeviceInfo, choice, device


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    found: dict[str, Any] = findings_of("batches", tmp_path_factory.mktemp("met"))
    return found


def test_results_come_in_order_from_both(found):
    assert [number for number, _ in found["made"]] == list(range(N))
    assert sorted({selector for _, selector in found["made"]}) == ["0:0", "0:1"]
    assert found["warned"] == ["each says this"]
    assert found["rises"]
    done, total = found["last"]
    assert done == total


def test_errors_name_the_device(found):
    assert found["failed"].startswith("DeviceError: device 0:1 ")
    assert found["failed"].endswith("]: out of memory")
    assert found["killed"].startswith("DeviceError: device 0:1 ")
    assert "its process died at item" in found["killed"]
    assert "expected devices, each once, got 0:0" in found["twice"]
    assert "expected one device, got 'all'" in found["single"]


def listed(selector: str, name: str, kind: str) -> DeviceInfo:
    return DeviceInfo(selector, name, f"platform {selector[0]}", "1", kind, 2**30, 2**30, 4)


def names_of_all(monkeypatch: pytest.MonkeyPatch, *there: DeviceInfo) -> list[str]:
    monkeypatch.setattr(device, "_found", lambda: [(info, None) for info in there])
    monkeypatch.setattr(choice, "_failure", lambda selector: None)
    monkeypatch.delenv("CLRADAR_DEVICE", raising=False)
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    return [info.selector for info in choice.select_devices("all")]


def test_all_are_the_gpus_each_once(monkeypatch):
    cpu, by_another_driver = listed("0:0", "C", "cpu"), listed("2:0", "A", "gpu")
    gpus = [listed("1:0", "A", "gpu"), listed("1:1", "A", "gpu"), listed("3:0", "B", "gpu")]
    there = cpu, *gpus[:2], by_another_driver, gpus[2]
    assert names_of_all(monkeypatch, *there) == [info.selector for info in gpus]


def test_without_gpus_all_are_those_like_the_default(monkeypatch):
    pocl = [listed(f"0:{i}", "A", "cpu") for i in range(2)]
    intel = replace(listed("1:0", "A", "cpu"), platform="Intel(R) OpenCL")
    assert names_of_all(monkeypatch, *pocl) == ["0:0", "0:1"]
    assert names_of_all(monkeypatch, *pocl, intel) == ["1:0"]
    monkeypatch.setenv("CLRADAR_DEVICE", "all")
    assert [info.selector for info in choice.select_devices(None)] == ["1:0"]


def test_the_list_marks_all_that_would_be_used(monkeypatch, capsys):
    names_of_all(monkeypatch, listed("0:0", "A", "cpu"), listed("0:1", "A", "cpu"))
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
