"""What a release states about itself, and that the pages for contributors name what there is."""

import importlib.util
import re
import shutil
import sys
from datetime import date
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from packaging.requirements import Requirement

from clradar import __version__

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
STATING = (
    "clradar/__init__.py",
    "CHANGELOG.md",
    "CITATION.cff",
    "packaging/conda/recipe.yaml",
    "pyproject.toml",
)
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def program(path: str) -> ModuleType:
    """A program of the checkout that is in no package."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    spec.loader.exec_module(module)
    return module


Stated = program("packaging/release_notes.py").Stated
hatch_build = program("hatch_build.py")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for name in STATING:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def changed(root: Path, name: str, old: str, new: str) -> None:
    text = (root / name).read_text("utf-8")
    assert old in text
    (root / name).write_text(text.replace(old, new, 1), "utf-8")


def test_every_file_states_the_same_version_and_date():
    stated = Stated.read(ROOT)
    assert stated.contradictions() == []
    assert set(stated.versions.values()) == {__version__}


@pytest.mark.parametrize("name", STATING[:4])
def test_another_version_is_found(copy, name):
    changed(copy, name, __version__, "9.8.7")
    (line,) = Stated.read(copy).contradictions()
    assert line.startswith("expected one version, found ")
    assert f"{name} 9.8.7" in line


def all_is_released(copy: Path) -> None:
    log = (copy / "CHANGELOG.md").read_text("utf-8")
    (copy / "CHANGELOG.md").write_text(log[log.index("\n## 0") :], "utf-8")


def test_a_tag_is_of_the_version_that_is_ready(copy):
    changed(copy, "pyproject.toml", 'repository = ""', 'repository = "https://a.example/b"')
    changed(copy, "CITATION.cff", "type:", 'repository-code: "https://a.example/b"\ntype:')
    all_is_released(copy)
    stated = Stated.read(copy)
    day = date.fromisoformat(stated.dates["CHANGELOG.md"])
    assert stated.against_tag(f"v{__version__}", day) == []
    (line,) = stated.against_tag("v9.8.7", day)
    assert line == f"expected the tag v{__version__}, got 'v9.8.7'"


def test_links_of_the_readme_lead_to_the_repository():
    text = "![a b](docs/c.png) [d](docs/e.md#f), [g](https://h.example) [i](#j)"
    made = hatch_build.with_addresses(text, "https://x.example/y", "1.2.3")
    assert made == (
        "![a b](https://x.example/y/raw/v1.2.3/docs/c.png) "
        "[d](https://x.example/y/blob/v1.2.3/docs/e.md#f), [g](https://h.example) [i](#j)"
    )
    without = hatch_build.with_addresses(text, "", "1.2.3")
    assert without == " d, [g](https://h.example) [i](#j)"


def test_the_recipe_needs_what_the_package_needs():
    """By the same names and bounds, on Linux; and a device."""
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text("utf-8"))
    oldest = {"sys_platform": "linux", "platform_machine": "x86_64", "python_version": "3.10"}
    needed = [Requirement(text) for text in PROJECT["dependencies"]]
    runs = {
        f"{CONDA_NAMES.get(one.name, one.name)} {one.specifier}"
        for one in needed
        if one.marker is None or one.marker.evaluate(oldest)
    }
    assert set(recipe["requirements"]["run"]) == {
        *runs,
        "pocl",
        "python >=${{ python_min }}",
    }
    assert PROJECT["requires-python"] == f">={recipe['context']['python_min']}"
    assert recipe["about"]["summary"] == PROJECT["description"]
    assert recipe["about"]["license"] == PROJECT["license"]
    ((command, entry),) = PROJECT["scripts"].items()
    assert recipe["build"]["python"]["entry_points"] == [f"{command} = {entry}"]


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md"])
def test_contributors_are_sent_to_files_that_exist(page):
    text = (ROOT / page).read_text("utf-8")
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert links
    named = re.findall(r"`([\w./]+\.(?:py|cl|json|cff|yaml|md)|\w+/[\w./]*)`", text)
    own = {"kernels/NAME.cl", "NAME.cl"}
    for path in {*links, *named} - own:
        beside = [ROOT / path, ROOT / "measurement_io" / "layouts" / path]
        assert any(one.exists() for one in beside), path
