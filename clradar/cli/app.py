"""The entry point: it imports the requested subcommand alone, and reports errors in one line."""

from __future__ import annotations

import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from clradar import __version__
from clradar.cli import console
from clradar.cli.groups import expanded
from clradar.errors import ClradarError, PackageError, handled_warnings
from clradar.files import interrupts
from clradar.versions import require_own

PANELS = {
    "Simulate": {
        "hand": "Write the mesh of a posed hand.",
        "simulate": "Simulate what the radar would record of one or several meshes.",
        "dataset": "Make training data after a plan: posed hands, simulated and imaged.",
        "demo": "Simulate, image and compare the embedded hand, with figure and metrics.",
    },
    "Read and image": {
        "image": "Form the image of a capture.",
        "process": "Process all frames of a recording: clean, image, compare, align, draw.",
        "convert": "Turn any supported recording into native captures, or captures into one.",
        "export": "Write a volume, its depth map or a capture for ParaView, MATLAB or numpy.",
    },
    "Look": {
        "inspect": "Describe what a file or a recording holds, or verify it.",
        "view": "Look at recordings, captures and volumes in a browser: images, 3-D points.",
        "compare": "Compare simulated images with a measured one, in numbers and in a figure.",
    },
    "Calibrate": {
        "clean": "Average frames, subtract the empty room, gate, correct the channels.",
        "channels": "Estimate gain and delay of every channel from a known target.",
        "diagnose": "Find the convention a capture was written in: axes, sign, mirror, order.",
        "align": "Find the motion that brings a simulated image, or a mesh, onto an image.",
        "register": "Find the pose of a measured mesh, and simulate it there.",
        "fit-hand": "Find the pose of a measured hand, joint by joint, and simulate it.",
        "sweep": "Find the alpha whose simulation is most like a measurement.",
    },
    "List": {
        "devices": "List the OpenCL devices, which of them work, and which is used.",
        "materials": "List materials: permittivity, reflectance, roughness, source.",
        "array": "Draw an antenna array: widths at -3 dB, grating lobes, range.",
    },
}
COMMANDS = {name: text for panel in PANELS.values() for name, text in panel.items()}
"""Subcommand, and the line that describes it."""

MODULES = {
    "hands": ("hand", "dataset"),
    "simulate": ("simulate", "demo"),
    "image": ("image",),
    "process": ("process",),
    "convert": ("convert", "export"),
    "look": ("inspect", "view", "compare"),
    "calibrate": ("clean", "channels", "diagnose"),
    "fit": ("align", "register", "fit-hand"),
    "sweep": ("sweep",),
    "lists": ("devices", "materials", "array"),
}
"""Modules of `clradar.cli.commands`, and the subcommands that each has."""


def help_record(one: Any, context: Any) -> tuple[str, str] | None:
    """The name of an argument or option and its help, as typer has them, without Python's types."""
    record = one.get_help_record(context)
    if record is None:
        return None
    name, text = record
    if one.param_type_name == "argument":
        name = re.sub(r" <[^<>]*>$", "" if one.nargs == 1 else "...", name)
    return name, text


class _Command(TyperCommand):
    """A command whose help has its options under headings."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Those of typer, without braces around what is required."""
        return [
            piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)
        ]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        found: dict[str, list[Any]] = {}
        for one in self.get_params(ctx):
            record = help_record(one, ctx)
            if record is not None:
                is_option = one.param_type_name == "option"
                panel = getattr(one, "rich_help_panel", None) or ""
                name = f"{panel} options".strip().capitalize() if is_option else "Arguments"
                found.setdefault(name, []).append(record)
        for name in sorted(found, key=[*HEADINGS, *found].index):
            with formatter.section(name):
                formatter.write_dl(found[name])


HEADINGS = ("Arguments", "Options", "Input options", "Grid options", "Output options")


class _Program(TyperGroup):
    """The program, whose help has its commands under headings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        _Command.format_options(self, ctx, formatter)  # type: ignore[arg-type]
        for name, texts in PANELS.items():
            with formatter.section(name):
                formatter.write_dl([(one.ljust(9), text) for one, text in texts.items()])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line with these arguments, or those of the process.

    Always ends in `SystemExit`: 0 done, 1 an error (one line on stderr), 2 wrong usage, 130
    interrupted, 143 terminated.
    """
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: for what an encoding lacks
    given = list(sys.argv[1:] if arguments is None else arguments)
    end = given.index("--") if "--" in given else len(given)
    debug = "--debug" in given[:end]
    given = [a for a in given[:end] if a != "--debug"] + given[end:]
    # What a shell completes is there; the program gets no arguments.
    typed = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")
    # The first argument that is no option: those before it have no values.
    requested = next((a for a in given or typed.split()[1:] if not a.startswith("-")), None)
    with handled_warnings(console.warning), console.log(debug):
        try:
            command = typer.main.get_command(program(requested, debug))
            status = command.main(args=given, prog_name="clradar", standalone_mode=False)
        except typer.Abort:
            status = 1
        except PackageError as error:
            console.error(error)
            status = 1
        except Exception as error:
            wrong: Any = error
            if not hasattr(wrong, "format_message"):  # typer has a click of its own, or not
                raise
            if type(wrong).__name__ == "NoArgsIsHelpError":
                wrong.show()
            else:  # wrong usage, on one line as all errors
                place = f"; see {wrong.ctx.command_path} -h" if wrong.ctx is not None else ""
                text = wrong.format_message().replace("Value error, ", "").rstrip(".")
                console.error(f"{text}{place}")
            status = wrong.exit_code
    raise SystemExit(status or 0)


def program(requested: str | None, debug: bool = False) -> typer.Typer:
    """The program, with the parameters of the subcommand that is requested."""
    # Plain help: brackets are no markup, and it reads the same in a pipe.
    app = typer.Typer(
        cls=_Program,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name, summary in COMMANDS.items():
        function: Callable[..., Any] = interrupts.heard  # of those that are not run, but listed
        if name == requested:
            require_own("calibration", "measurement_io")
            from clradar.cli.outputs import check_outputs

            command = function_of(name)
            function = _guarded(expanded(command, check_outputs), debug)
            summary = f"{summary}\n\n{inspect.getdoc(command)}"
        app.command(name, cls=_Command, help=summary, short_help=COMMANDS[name])(function)
    return app


def function_of(name: str) -> Callable[..., Any]:
    own = next(own for own, names in MODULES.items() if name in names)
    found: Callable[..., Any] = getattr(
        import_module(f"clradar.cli.commands.{own}"), f"{name.replace('-', '_')}_command"
    )
    return found


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"clradar {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Show the version and exit.", is_eager=True, callback=_show_version
        ),
    ] = False,
    debug: Annotated[
        bool,
        typer.Option(
            "--debug",
            help="Show tracebacks of errors and notes on devices; before or after COMMAND.",
        ),
    ] = False,
) -> None:
    """Simulate, read, image and compare captures of near-field imaging radars.

    Lengths are in millimetres and frequencies in gigahertz, as the options' names say. Nothing is
    overwritten without --force. The folder that an output goes into has to exist; a folder that is
    the output itself is made. Exit status: 0 done, 1 an error (one line on stderr), 2 wrong
    usage.
    """


def _guarded(function: Callable[..., Any], debug: bool) -> Callable[..., Any]:
    """Turn every error of a function into one line and an exit status."""

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except (typer.Exit, typer.Abort, typer.BadParameter):
            raise
        except KeyboardInterrupt as interruption:
            raise _interrupted(*interruption.args) from None
        except Exception as error:
            if interrupts.heard():
                raise _interrupted() from None
            if debug:
                raise
            several = getattr(error, "mistakes", ())
            for line in str(error).split("\n") if several else [_message(error)]:
                console.error(line)
            raise typer.Exit(1) from None

    return run


def _interrupted(*words: str) -> typer.Exit:
    console.error("; ".join(["interrupted", *words]), "")
    return typer.Exit(interrupts.exit_status())


def _message(error: Exception) -> str:
    if isinstance(error, ClradarError) and str(error):
        text, missing, _ = str(error).partition(", got nothing there (")
        place, found, expected = text.rpartition(": expected ")
        if missing and found:
            return f"{place}: no such file; expected {expected}"
        return str(error)
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    kind = type(error).__name__
    text = f"{kind}: {error}" if str(error) else kind
    return f"unexpected {text} (--debug shows where)"
