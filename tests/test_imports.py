"""Layers of modules: imports go downwards only, as docs/architecture.md describes."""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("clradar", "measurement_io", "calibration")

# The packages and modules of clradar. Each imports from the lines above its own only; "clradar" is
# the public interface.
LAYERS = (
    ("constants", "errors"),
    ("files", "versions"),
    ("model",),
    ("arrays", "reference", "opencl"),
    ("geometry", "jobs"),
    ("tracing",),
    ("phasors",),
    ("imaging",),
    ("trace", "synthesize", "simulation", "backproject"),
    ("hand", "impairments"),
    ("rigs", "compare"),
    ("motion",),
    ("plot",),
    ("clradar",),
    ("report", "dataset"),
    ("view",),
    ("cli",),
)
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(path): path for name in PACKAGES for path in ROOT.glob(f"{name}/**/*.py")}


@cache
def trees() -> dict[str, ast.Module]:
    """Parsed when a test asks, not when tests are collected: once, in one process."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in FILES.items()}


def imports_of(name: str, nodes: list[ast.AST]) -> set[str]:
    """Full names of what a module imports anywhere in it: modules of ours, or others as written."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute here"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in FILES else node.module)
    return found


@cache
def nodes() -> dict[str, list[ast.AST]]:
    """Of every module, each walked through once."""
    return {name: list(ast.walk(tree)) for name, tree in trees().items()}


@cache
def imports() -> dict[str, set[str]]:
    """What every module imports."""
    return {name: imports_of(name, found) for name, found in nodes().items()}


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def package_of(name: str) -> str:
    """The package of clradar that a module belongs to, such as model."""
    if name == "clradar.__main__":  # the command line, by `python -m`
        return "cli"
    return name.split(".")[1] if "." in name else name


def breaches(importers: list[str], forbidden: list[str]) -> list[str]:
    return [
        f"{importer} imports {name}"
        for importer in importers
        for name in sorted(imports()[importer])
        if any(within(name, package) for package in forbidden)
    ]


def modules(*packages: str) -> list[str]:
    return [name for name in sorted(FILES) if any(within(name, p) for p in packages)]


def test_there_are_few_packages_and_each_has_its_layer():
    packages = {package_of(name) for name in modules("clradar")} - {"clradar"}
    assert packages == set(RANK) - {"clradar"}
    assert len(packages) <= 30


def test_clradar_imports_downwards():
    for name in modules("clradar"):
        here = package_of(name)
        for imported in imports()[name]:
            there = package_of(imported)
            if within(imported, "clradar") and there != here:
                assert RANK[there] < RANK[here], f"{name} imports {imported}, which is not below it"


def test_only_the_opencl_package_imports_pyopencl():
    others = [name for name in FILES if not within(name, "clradar.opencl")]
    assert not breaches(others, ["pyopencl"])
    assert breaches(modules("clradar.opencl"), ["pyopencl"])  # the check finds them where they are


def test_the_model_and_the_readers_need_no_device_and_no_computation():
    allowed = ["clradar.model", "clradar.errors", "clradar.constants", "clradar.files"]
    for package, more in (("clradar.model", []), ("measurement_io", ["clradar.arrays"])):
        for name in modules(package):
            for imported in imports()[name]:
                if within(imported, "clradar") or within(imported, "calibration"):
                    assert any(within(imported, one) for one in allowed + more), (name, imported)


def test_only_what_works_with_files_imports_the_readers_and_the_calibration():
    readers = ("cli", "dataset", "view")
    assert not breaches(modules("calibration", "measurement_io"), ["clradar.cli"])
    library = [n for n in modules("clradar") if package_of(n) not in readers]
    assert not breaches(library, ["measurement_io", "calibration", "clradar.cli"])
    readers_alone = modules("clradar.dataset", "clradar.view")
    assert not breaches(readers_alone, ["calibration", "clradar.cli"])


def test_the_reference_shares_no_code_with_what_it_checks():
    for module in modules("clradar.reference"):
        ours = {name for name in imports()[module] if within(name, "clradar")}
        assert ours - {"clradar.reference"} == {"clradar.model"}


def test_nothing_unpickles_arrays():
    sources = dict(nodes())
    for folder in ("benchmarks", "examples"):
        for path in sorted((ROOT / folder).glob("**/*.py")):
            sources[str(path)] = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    for name, found in sources.items():
        for call in (node for node in found if isinstance(node, ast.Call)):
            for keyword in call.keywords:
                where = f"{name}: line {keyword.value.lineno}"
                if keyword.arg == "allow_pickle":
                    assert ast.unparse(keyword.value) == "False", where


def test_only_frames_and_hand_models_are_pickles():
    # Writing one runs no code; clradar.files.pickles reads them, for what runs confined.
    reader = "clradar.files.pickles"
    others = [name for name in FILES if name not in ("measurement_io.maroon.writer", reader)]
    confined = ("measurement_io.maroon.frame_file", "clradar.rigs.mano")
    assert not breaches([name for name in others if name not in confined], [reader])
    assert not breaches(others, ["pickle", "cPickle", "dill", "joblib", "shelve", "marshal"])
    for name, found in nodes().items():
        loads = [
            n
            for n in found
            if isinstance(n, ast.Attribute)
            and n.attr in ("load", "loads", "Unpickler")
            and ast.unparse(n.value) == "pickle"
        ]
        # There it is the base of a class whose find_class has a list of exact names.
        assert len(loads) == (name == reader), name


def test_there_are_no_circles():
    # What a package imports itself from is its own modules; that is how it shows them.
    graph = {
        name: {n for n in imported if n in FILES and n != name}
        for name, imported in imports().items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))
