"""What runs the tests elsewhere: the end of `.ci/run`, workflows, what is installed there."""

import functools
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from test_release import PROJECT, ROOT

WORKFLOWS = ROOT / ".github" / "workflows"


@pytest.mark.skipif(not WORKFLOWS.exists(), reason="no checkout: .github is not here")
@pytest.mark.parametrize("name", ["release.yml", "tests.yml"])
def test_jobs_and_commands_exist_actions_have_a_version_and_few_rights(name):
    """One job alone may do more than read: it proves to the index who it is, without a password."""
    text = (WORKFLOWS / name).read_text("utf-8")
    whole = yaml.safe_load(text)
    found: dict[str, Any] = whole["jobs"]
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for job in found.values():
        assert set(job.get("needs", "").split()) <= set(found)
        assert (WORKFLOWS / Path(job.get("uses", "tests.yml")).name).exists()
        for step in job.get("steps", []):
            words = shlex.split(step.get("run", ""))
            if words[:1] == ["make"]:
                assert {word for word in words[1:] if "=" not in word} <= set(targets)
            for word in words:
                if word.endswith(".py"):
                    assert (ROOT / word).exists(), word
    for action in re.findall(r"uses: (?!\./)(\S+)", text):
        assert re.search(r"@(v\d+|release/v\d+)$", action), action
    assert "secrets." not in text
    assert whole["permissions"] == {"contents": "read"}
    rights = {key: job["permissions"] for key, job in found.items() if "permissions" in job}
    assert rights == ({"publish": {"id-token": "write"}} if name == "release.yml" else {})


PLATFORMS = {
    "x86_64-manylinux_2_28": ("linux", "x86_64", {"pyopencl[pocl]"}),
    "aarch64-manylinux_2_28": ("linux", "aarch64", set()),
    "aarch64-apple-darwin": ("darwin", "arm64", set()),
    "x86_64-apple-darwin": ("darwin", "x86_64", set()),
    "x86_64-pc-windows-msvc": ("win32", "AMD64", {"intel-opencl-rt"}),
}
"""By its name for uv: sys_platform, platform_machine, and what brings an OpenCL device there."""

VERSIONS = ("3.10", "3.14")

REQUIRE_INDEX = "CLRADAR_REQUIRE_INDEX"
"""Where it is set, a package index that does not answer is a failure, and no reason to skip."""


@pytest.mark.parametrize("platform", PLATFORMS)
def test_an_opencl_device_comes_with_the_install_where_there_is_one(platform):
    system, machine, expected = PLATFORMS[platform]
    environment = {"sys_platform": system, "platform_machine": machine, "python_version": "3.12"}
    wanted = {
        requirement.name + ("[pocl]" if requirement.extras else "")
        for requirement in map(Requirement, PROJECT["dependencies"])
        if requirement.marker is None or requirement.marker.evaluate(environment)
    }
    runtimes = {"pyopencl", "pyopencl[pocl]", "intel-opencl-rt"}
    assert wanted & runtimes == expected | {"pyopencl"}


def resolved(platform: str, version: str, source: Path, *options: str) -> tuple[int, str]:
    """Exit status and output of resolving wheels alone."""
    command = ("uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate")
    wheels = ("--only-binary", ":all:")
    chosen = ["--python-platform", platform, "--python-version", version, *options, str(source)]
    done = subprocess.run(
        [sys.executable, "-m", *command, *wheels, *chosen],
        cwd=ROOT,
        env=os.environ | {"MACOSX_DEPLOYMENT_TARGET": "14.0"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


@functools.cache
def what_the_index_lacks(folder: Path) -> str:
    """Why nothing can be resolved here; empty where one package can, so that failures are ours."""
    source = folder / "one.in"
    source.write_text("packaging\n", encoding="utf-8")
    status, said = resolved("x86_64-manylinux_2_28", "3.12", source)
    return said if status else ""


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_there_are_wheels_for_all_that_is_needed(platform, version, tmp_path_factory):
    lacking = what_the_index_lacks(tmp_path_factory.getbasetemp())
    if lacking:
        assert not os.environ.get(REQUIRE_INDEX), lacking
        pytest.skip("no package index answers: wheels for five systems were not looked for")
    status, said = resolved(platform, version, ROOT / "pyproject.toml", "--extra", "test")
    assert status == 0, said
    expected = PLATFORMS[platform][2]
    assert ("\npocl-binary-distribution==" in said) == ("pyopencl[pocl]" in expected), said
    assert ("\nintel-opencl-rt==" in said) == ("intel-opencl-rt" in expected), said
    assert "\npyopencl==" in said
