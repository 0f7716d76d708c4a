"""The commands put together, and the exit codes: 1 a fault of the program, 2 bad input, 130 interrupted."""

import contextlib
import ctypes
import io
import logging
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from cyclopts import CycloptsError

from tg4mm.capture.options import ConvertOptions, SfmOptions
from tg4mm.cli import bench, recordings, results
from tg4mm.cli.generated import application, command, joined_bands, message_of
from tg4mm.core import __version__
from tg4mm.core.errors import Tg4mmError, one_line, system_says
from tg4mm.core.extras import EXTRA_OF, EXTRAS_OF_COMMAND, install
from tg4mm.core.parent import end_with_parent
from tg4mm.core.progress import print_any_text, say
from tg4mm.research.options import DemoOptions, EvaluateOptions
from tg4mm.run.options import LIST_SETTINGS, TrainOptions
from tg4mm.show import options as show

BAD_INPUT, INTERRUPTED = 2, 130
# Options of mallopt(3) with their values in bytes: free memory that the heap keeps, the size from which an array is
# mapped by itself, and free memory that a thread's arena keeps, which grows in heaps of 64 MiB.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _TOP_PAD = (-1, 1 << 30), (-3, 1 << 30), (-2, 1 << 26)
ABOUT = """3D motion magnification: shows and measures subtle vibration, from any viewpoint.

look finds in seconds what vibrates in a video. process does everything with one, in one folder; its steps are
commands, too: sfm makes a dataset from videos or photographs, train fits a model to it and writes it to a run
folder; render, view, measure, report and export use a run folder; analyse computes engineering quantities of a
measurement. generate renders a dataset in Blender.

Lengths are in scene units, frequencies in Hz, times in timesteps. A magnification α turns a displacement δ into
(1 + α) δ.
"""
GENERATE = "generate"  # everything after it, --help included, is dataset_gen's own
_NONE_AT_ALL = "--methods"  # empty, it asks for none of ours: docs/protocol.md

COMMANDS: dict[str, Any] = {
    "demo": command(DemoOptions, recordings.demo),
    GENERATE: recordings.generate,
    "look": command(show.LookOptions, recordings.look),
    "train": command(TrainOptions, recordings.train),
    "measure": command(show.MeasureOptions, results.measure),
    "convert": command(ConvertOptions, recordings.convert),
    "process": command(show.ProcessCommand, recordings.process),
    "analyse": command(show.AnalyseCommand, results.analyse),
    "render": command(show.RenderOptions, results.render),
    "evaluate": command(EvaluateOptions, results.evaluate),
    "report": command(show.ReportCommand, results.report),
    "view": command(show.ViewOptions, results.view),
    "export": command(show.ExportOptions, results.export),
    "sfm": command(SfmOptions, recordings.sfm),
}
app = application("tg4mm", ABOUT, version=f"tg4mm {__version__}")
for _rank, (_name, _call) in enumerate(COMMANDS.items()):
    app.command(_call, name=_name, sort_key=_rank)
app.command(bench.app)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program on `argv` (default: the command line) and return its exit code."""
    warnings.formatwarning = _warning_line  # a user gains nothing from the line of code that warns
    end_with_parent()  # a step of a benchmark
    _keep_freed_memory()
    print_any_text()
    _show_log()
    arguments = [_as_path(word) for word in (sys.argv[1:] if argv is None else argv)]
    try:
        return _run(arguments)
    except CycloptsError as error:
        return _fail(message_of(error, arguments))
    except Tg4mmError as error:
        return _fail(str(error))
    except BrokenPipeError:  # the reader of our output has gone
        _silence_output()
        return 1
    except OSError as error:  # a path that cannot be read or made, a full disk
        return _fail(system_says(error, named=True))
    except KeyboardInterrupt:
        print("\ntg4mm: interrupted; run the same command again to continue", file=sys.stderr)
        return INTERRUPTED
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if (extra := EXTRA_OF.get(package)) is None:
            raise
        extras = EXTRAS_OF_COMMAND.get(next(iter(arguments), ""), (extra,))
        return _fail(f"this command needs {package}: {install(*extras)}")


def _keep_freed_memory() -> None:
    """Let glibc hand freed memory on to the next large array.

    By default it returns arrays of 32 MiB or more and the empty heaps of a thread's arena to the system; new pages took
    half of all time in the system.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        for option in _TRIM_THRESHOLD, _MMAP_THRESHOLD, _TOP_PAD:
            mallopt(*option)


def _run(words: list[str]) -> int:
    _check_filled(words)
    if words[:1] == [GENERATE]:
        return recordings.run_generate(words[1:])
    if words[:1] == ["train"] and LIST_SETTINGS in words:
        return recordings.list_settings()
    if words in ([], ["bench"]):
        with contextlib.redirect_stdout(sys.stderr):
            app([*words, "--help"])
        return BAD_INPUT
    result = app(joined_bands(words), print_error=False, exit_on_error=False)
    sys.stdout.flush()  # a reader that has gone is noticed here
    return result if isinstance(result, int) else 0


def help_text(*words: str) -> str:
    """Return what --help of a command prints, in as many columns as the terminal has."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        app([*words, "--help"], print_error=False, exit_on_error=False)
    return printed.getvalue().strip()


def _silence_output() -> None:
    """Send what is still buffered nowhere: Python writes it when it exits, and would complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _as_path(word: str) -> str:
    """A file's name that starts with -, as -x.mp4 or --x.mp4, with ./ before it, which no option has."""
    is_option = not word.startswith("-") or word == "-h" or (word.startswith("--") and "." not in word)
    return word if is_option or re.fullmatch(r"-[\d.e]+", word) or not os.path.lexists(word) else f"./{word}"


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
        say("warning" if record.levelno >= logging.WARNING else "note", self.format(record))


def _show_log() -> None:
    log = logging.getLogger("tg4mm")
    log.setLevel(logging.INFO)
    if not any(isinstance(handler, _ToStderr) for handler in log.handlers):
        log.addHandler(_ToStderr())


def _warning_line(message: Warning | str, *_where: object, **_more: object) -> str:
    return f"tg4mm: {one_line(str(message))}\n"


def _fail(message: str) -> int:
    say("error", message, "tg4mm: ")
    return BAD_INPUT
