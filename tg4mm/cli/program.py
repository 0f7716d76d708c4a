"""The commands put together, and the exit codes: 1 a fault of the program, 2 bad input, 130 interrupted."""

import logging
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated

import typer

from tg4mm import __version__
from tg4mm.cli.analyse import analyse
from tg4mm.cli.bench import bench
from tg4mm.cli.convert import convert
from tg4mm.cli.demo import demo
from tg4mm.cli.evaluate import evaluate
from tg4mm.cli.export import export
from tg4mm.cli.generate import generate
from tg4mm.cli.look import look
from tg4mm.cli.magnify import BandsCommand
from tg4mm.cli.measure import measure
from tg4mm.cli.process import process
from tg4mm.cli.render import render
from tg4mm.cli.report import report
from tg4mm.cli.sfm import sfm
from tg4mm.cli.train import train
from tg4mm.cli.view import view
from tg4mm.core import events
from tg4mm.core.errors import Tg4mmError, one_line, system_says
from tg4mm.core.extras import EXTRA_OF, EXTRAS_OF_COMMAND, install
from tg4mm.core.parent import end_with_parent
from tg4mm.fit.precompile import enable

BAD_INPUT, INTERRUPTED = 2, 130

app = typer.Typer(
    name="tg4mm",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Everything after `generate`, --help included, is dataset_gen's own.
_PASS_ALL = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "allow_interspersed_args": False,
    "help_option_names": [],
}
app.command()(demo)
app.command(context_settings=_PASS_ALL)(generate)
app.command()(look)
app.command(cls=BandsCommand)(train)
app.command(cls=BandsCommand)(measure)
app.command()(convert)
for _command in (process, analyse, render, evaluate, report, view, export, sfm):
    app.command(cls=BandsCommand)(_command)
app.add_typer(bench, name="bench")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tg4mm {__version__}")
        raise typer.Exit


@app.callback()
def tg4mm(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """3D motion magnification: shows and measures subtle vibration, from any viewpoint.

    look tells in seconds what vibrates in a video. process does everything with one, in one folder; its steps are
    commands, too: sfm makes a dataset from videos or photographs, train fits a model to it and writes it to a run
    folder; render, view, measure, report and export use a run folder; analyse
    computes what an engineer wants of a measurement. generate renders a dataset in Blender.

    Lengths are in scene units, frequencies in Hz, times in timesteps. A magnification α turns a displacement δ into
    (1 + α) δ.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program on `argv` (default: the command line) and return its exit code."""
    warnings.formatwarning = _warning_line  # a user gains nothing from the line of code that warns
    end_with_parent()  # a step of a benchmark
    events.print_any_text()
    _show_log()
    enable()
    try:
        arguments = [_as_path(word) for word in (sys.argv[1:] if argv is None else argv)]
        _check_filled(arguments)
        result = app(args=arguments, prog_name="tg4mm", standalone_mode=False)
    except Tg4mmError as error:
        return _fail(str(error))
    except OSError as error:  # a path that cannot be read or made, a full disk
        return _fail(system_says(error, named=True))
    except KeyboardInterrupt:
        return _interrupted()
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if (extra := EXTRA_OF.get(package)) is None:
            raise
        extras = EXTRAS_OF_COMMAND.get(next(iter(arguments), ""), (extra,))
        return _fail(f"this command needs {package}: {install(*extras)}")
    except Exception as error:
        # Usage errors as typer reports them; their class has moved between its versions.
        if not hasattr(error, "format_message"):
            raise
        return _usage(error)
    if result == INTERRUPTED:  # newer versions of typer turn Ctrl+C into this
        return _interrupted()
    return result if isinstance(result, int) else 0


def _as_path(word: str) -> str:
    """A file's name that starts with -, as -x.mp4 or --x.mp4, with ./ before it, which no option has."""
    is_option = not word.startswith("-") or word == "-h" or (word.startswith("--") and "." not in word)
    return word if is_option or re.fullmatch(r"-[\d.e]+", word) or not os.path.lexists(word) else f"./{word}"


_NONE_AT_ALL = "--methods"  # empty, it asks for none of ours: docs/protocol.md


def _check_filled(arguments: Sequence[str]) -> None:
    """An empty one, as an unset variable of a shell leaves it, would be taken for the folder one is in."""
    for before, word in zip(("", *arguments), arguments, strict=False):
        is_empty = not word or (word.startswith("--") and word.endswith("="))
        if is_empty and _NONE_AT_ALL not in (before, word[:-1]):
            after = f"what follows {before}" if before.startswith("-") else "an argument"
            raise Tg4mmError(f"{word.rstrip('=') or after} is empty")


class _ToStderr(logging.Handler):
    """Lines of the log where progress is shown as well."""

    def emit(self, record: logging.LogRecord) -> None:
        # typer.echo would write into the middle of a progress bar
        events.say("warning" if record.levelno >= logging.WARNING else "note", self.format(record))


def _show_log() -> None:
    log = logging.getLogger("tg4mm")
    log.setLevel(logging.INFO)
    if not any(isinstance(handler, _ToStderr) for handler in log.handlers):
        log.addHandler(_ToStderr())


def _warning_line(message: Warning | str, *_where: object, **_more: object) -> str:
    return f"tg4mm: {one_line(str(message))}\n"


def _usage(error: Exception) -> int:
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError" and context is not None:
        typer.echo(context.get_help(), err=True)
        return BAD_INPUT
    command = context.command_path if context is not None else "tg4mm"
    message = " ".join(error.format_message().split()).rstrip(".")  # type: ignore[attr-defined]
    return _fail(f"{message}{_offending(error, message)} (see {command} --help)")


def _offending(error: Exception, message: str) -> str:
    """The value that typer's message leaves out where pydantic did the conversion."""
    try:
        value = error.__cause__.errors()[0]["input"]  # type: ignore[union-attr]
    except (AttributeError, LookupError, TypeError):
        return ""
    return "" if repr(value) in message else f", got {value!r}"


def _fail(message: str) -> int:
    events.say("error", message, "tg4mm: ")
    return BAD_INPUT


def _interrupted() -> int:
    typer.echo("\ntg4mm: interrupted; run the same command again to continue", err=True)
    return INTERRUPTED
