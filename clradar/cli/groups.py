"""Groups of options, of which a command takes a record each, and the command that runs.

A group is a dataclass of fields by `option`, `argument`, `written` and `output_option`, which are
defaults of single parameters of a command, too. What they say is checked for all commands alike.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Set
from contextlib import suppress
from dataclasses import Field, dataclass, field, fields, is_dataclass
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from clradar.errors import ClradarError
from clradar.files.hashing import content_record

UNITS = ("mm", "deg", "db", "hz", "ps", "s")
"""Of names of options: the help shows them in place of the value."""

METAVARS: dict[Any, str] = {Path: "FILE", int: "N", float: "X"}
"""What the help shows in place of other values."""

SCALES = {"mm": ("m", 1e3), "ps": ("s", 1e12)}
"""What functions take in place of them, and how many are one of it."""

Read = Callable[[str, Any], Any]
"""Reads or checks what was given: called with the option's name and the value."""


@dataclass
class Call:
    """A command, its options that count for results, all that were typed, inputs and outputs."""

    command: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    typed: Set[str] = frozenset()
    inputs: dict[str, list[Path]] = field(default_factory=dict)  # by option: files and folders
    force: bool = False
    read: dict[Path, list[Path]] = field(default_factory=dict)  # of an input: its files
    records: dict[Path, dict[str, Any]] = field(default_factory=dict)  # of files, by content

    @property
    def paths(self) -> list[Path]:
        """All inputs, as they were typed."""
        return [path for paths in self.inputs.values() for path in paths]

    def files_of(self, paths: Iterable[Path]) -> list[Path]:
        """The files whose content these inputs are, each once."""
        found = (file for path in paths for file in self.read.get(path, [path]))
        return [*dict.fromkeys(one for file in found if not file.is_dir() for one in _parts(file))]

    def records_of(self, files: Iterable[Path]) -> dict[Path, dict[str, Any]]:
        """What files held when it was first asked for: before the work (`content_record`)."""
        self.records |= {path: content_record(path) for path in files if path not in self.records}
        return self.records


def _parts(file: Path) -> list[Path]:
    """A file, and those that belong to it: buffers of glTF, the antennas of a recorded frame."""
    if file.suffix == ".npy":
        from measurement_io.maroon.folders import antennas_file

        antennas = antennas_file(file)
        return [file, antennas] if antennas is not None and antennas.is_file() else [file]
    from clradar.files.meshes.gltf_document import files_of

    return files_of(file)


call = Call()


def plain(value: Any, *, paths: bool = True) -> Any:
    """A value in types that JSON reads back as they were; None in place of `paths`, if wanted."""
    if isinstance(value, Path):
        return str(value) if paths else None
    if isinstance(value, dict):
        return {name or "": plain(item, paths=paths) for name, item in value.items()}
    many = isinstance(value, list | tuple)
    return [plain(item, paths=paths) for item in value] if many else value


def wrong_usage(option: str, text: str) -> typer.BadParameter:
    """The error that names the option and ends in exit status 2."""
    return typer.BadParameter(text, param_hint=option)


RULES: dict[str, Any] = {
    "kind": typer.Option, "needs": "", "without": "", "due": "", "parse": None, "check": None,
    "text": str, "panel": "", "writes": False, "files": None,
}  # fmt: skip
"""What is known of an option beside what typer knows, and the defaults."""


def option(help: str, default: Any = None, *names: str, **details: Any) -> Any:
    """A field that is an option; without `names` ``edge_mm`` is ``--edge-mm``.

    Without a default it is required, unless its type has None. `parse` makes a value of its `text`,
    `check` is of the value that typer makes. It goes with one of the options `needs`, where the
    command has them, and never with those of `without`; one of `due` demands it. These are names
    with blanks between them, or as ``--method=sparse|exact``. The help shows it under the heading
    `panel`. It `writes` a file that must not be there, or names
    `files` to read in a value that is no path, and is `kept` among the settings of results, as all
    are but those of outputs. The other `details` are those of `typer.Option`.
    """
    rules = {name: details.pop(name, value) for name, value in RULES.items()}
    kept = details.pop("kept", rules["panel"] != "Output")
    known = {**rules, "default": default, "names": names, "kept": kept}
    parse = rules["parse"]
    value = parse("", default) if parse is not None and isinstance(default, str) else default
    return field(metadata={**known, "details": {"help": help, **details}}, default=value)


def argument(help: str, default: Any = None, **details: Any) -> Any:
    """A field that is a positional argument; `details` as of `option`."""
    return option(help, default, kind=typer.Argument, **details)


def written(help: str, *names: str, **details: Any) -> Any:
    """A field that is the option of a file to write."""
    return option(help, None, *names, panel="Output", writes=True, **details)


def output_option(
    help: str, default: Any = None, *names: str, folder: bool = False, **details: Any
) -> Any:
    """A field that is the option ``-o``; a `folder` is for the command to check."""
    names = ("-o", "--output", *names)
    return option(help, default, *names, panel="Output", writes=not folder, **details)


FORCE: Any = option("Replace files that exist.", False, "--force", panel="Output")
"""Of every command that writes something, unless it has its own."""


def option_name(name: str, one: Field[Any]) -> str:
    """The name of the option of a field, or that which help gives an argument."""
    if one.metadata["kind"] is typer.Argument:
        return str(one.metadata["details"].get("metavar") or name.upper().removesuffix("S"))
    return str((one.metadata["names"] or ("--" + name.replace("_", "-"),))[0])


def expanded(
    command: Callable[..., Any], check: Callable[[Iterable[Any]], None] = lambda outputs: None
) -> Callable[..., Any]:
    """Give a command one keyword for each field of its groups: the parameters that typer reads.

    Before it runs, `check` raises where an output cannot be written.
    """
    shown = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        n: p.annotation for n, p in shown.parameters.items() if is_dataclass(p.annotation)
    }
    declared: dict[str, Field[Any]] = {}
    parameters = [Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    for name, parameter in shown.parameters.items():
        own, hints, panel = {name: parameter.default}, {name: parameter.annotation}, ""
        if name in groups:
            own, hints = {f.name: f for f in fields(groups[name])}, get_type_hints(groups[name])
            panel = getattr(groups[name], "PANEL", "")
        declared |= own
        parameters += [_parameter(n, hints[n], one, panel) for n, one in own.items()]
    writing = [name for name, one in declared.items() if _is_output(one)]
    if "force" not in declared and writing:
        declared["force"] = FORCE
        parameters.append(_parameter("force", bool, FORCE, ""))
    label = command.__name__.removesuffix("_command").replace("_", "-")

    def run(context: typer.Context, **values: Any) -> Any:
        sources = {name: context.get_parameter_source(name) for name in declared}
        typed = {n for n, source in sources.items() if source and source.name != "DEFAULT"}
        _check_together(declared, values, typed)
        for name, one in declared.items():
            for read in (one.metadata["parse"], one.metadata["check"]):
                if read is not None and values[name] is not None:
                    values[name] = read(option_name(name, one), values[name])
        kept = {name: values[name] for name, one in declared.items() if one.metadata["kept"]}
        force = bool(values.get("force"))
        records = {
            name: group(**{one.name: values[one.name] for one in fields(group)})
            for name, group in groups.items()
        }
        single = {name: values[name] for name in shown.parameters if name not in groups}
        named = {
            option_name(name, one): (one.metadata["files"] or paths_in)(values[name])
            for name, one in declared.items()
            if values[name] is not None and not _is_output(one)
        }
        inputs = {option: paths for option, paths in named.items() if paths}
        vars(call).update(vars(Call(label, kept, typed, inputs, force)))
        try:
            check(values[n] for n, one in declared.items() if one.metadata["writes"])
            if any(values[name] is not None for name in writing):
                for path in filter(Path.is_file, call.paths):
                    with suppress(ClradarError):  # the reader of the file says why
                        call.records_of(call.files_of([path]))
            return command(**records, **single)
        finally:  # the next one of this process has none of its inputs
            vars(call).update(vars(Call()))

    run.__signature__ = shown.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _is_output(one: Field[Any]) -> bool:
    return one.metadata["writes"] or one.metadata["names"][:1] == ("-o",)


def _parameter(name: str, hint: Any, one: Field[Any], panel: str) -> Parameter:
    known, details = one.metadata, dict(one.metadata["details"])
    names, unit, default = known["names"], name.rpartition("_")[2], known["default"]
    required = default is None and type(None) not in get_args(hint)
    kind = next((kind for kind in METAVARS if kind in (hint, *get_args(hint))), None)
    if known["parse"] is not None:
        hint = known["text"] if default is not None else known["text"] | None
    if known["kind"] is typer.Argument:
        details["metavar"] = option_name(name, one)
    else:
        names = names or (option_name(name, one),)
        shown = unit.upper() if unit in UNITS else METAVARS.get(kind)
        details.setdefault("metavar", shown)
        details["rich_help_panel"] = known["panel"] or panel or None
    annotation: Any = Annotated[hint, known["kind"](*names, **details)]
    default = Parameter.empty if required else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _check_together(
    declared: dict[str, Field[Any]], values: dict[str, Any], typed: set[str]
) -> None:
    fields_of = {option_name(name, one): name for name, one in declared.items()}
    there = {name for name, key in fields_of.items() if key in typed}

    def known(rules: str) -> Iterator[tuple[bool, str]]:
        """Whether each holds, in a command that has its option, and its text."""
        for rule in rules.split():
            name, equals, choices = rule.partition("=")
            if name in fields_of:
                holds = values[fields_of[name]] in choices.split("|") if equals else name in there
                yield holds, rule.replace("=", " ").replace("|", " or ")

    for name, key in fields_of.items():
        rules = declared[key].metadata
        if name not in there:
            for holds, rule in known(rules["due"]):
                if holds:
                    raise wrong_usage(name, f"{rule} needs it")
            continue
        needed = list(known(rules["needs"]))
        if needed and not any(holds for holds, _ in needed):
            raise wrong_usage(name, f"expected {' or '.join(r for _, r in needed)} with it")
        for holds, rule in known(rules["without"]):
            if holds:
                raise wrong_usage(name, f"expected without {rule}")


def paths_in(value: Any) -> list[Path]:
    """The paths that a value is, or has in it."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [path for one in value for path in paths_in(one)]
    return [value] if isinstance(value, Path) else []


def given(group: Any, part: Any = None) -> dict[str, Any]:
    """The options of a group, or of a `part`, that were typed, or are not at their default."""
    values = {one: getattr(group, one.name) for one in fields(part or group)}
    return {
        option_name(f.name, f): value
        for f, value in values.items()
        if f.name in call.typed or value != f.default
    }


def arguments_of(group: Any, part: Any = None) -> dict[str, Any]:
    """The arguments that a group, or what it has of `part`, is for a function: what is not None.

    Functions take metres and seconds: `edge_m` of `edge_mm`.
    """
    found = {}
    for one in fields(part or group):
        value, (name, _, unit) = getattr(group, one.name), one.name.rpartition("_")
        base, scale = SCALES.get(unit, (unit, 1.0))
        if value is not None:
            found[f"{name}_{base}".lstrip("_")] = scaled(value, scale) if scale != 1.0 else value
    return found


def scaled(value: Any, scale: float) -> Any:
    """A number of a unit, or several, in the unit that is `scale` times as large."""
    return value / scale if isinstance(value, float) else tuple(one / scale for one in value)
