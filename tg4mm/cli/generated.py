"""Commands made of options classes (`tg4mm/core/options.py`): their parameters, parsing by cyclopts, their help."""

import inspect
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from enum import Enum, EnumMeta
from typing import Annotated, Any, TypeVar, get_args, get_origin

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import MissingArgumentError, UnusedCliTokensError
from cyclopts.help import HelpEntry, HelpPanel
from cyclopts.validators import Number

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import AUTO, REQUIRED, Spelling, spellings

T = TypeVar("T")
_TEXTS = (str, str | None, tuple[str, ...])
_INDENT, _COLUMN, _WIDEST = 2, 30, 100  # columns of --help


def application(name: str, about: str, **more: Any) -> App:
    """Return a program, or a command that has commands."""
    return App(
        name=name,
        help=about,
        help_flags=["-h", "--help"],
        help_format="plaintext",
        help_formatter=PlainHelp(),
        group_parameters="Options",
        default_parameter=Parameter(negative_iterable="", consume_multiple=False),
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        **more,
    )


def command(options: type[T], run: Callable[[T], Any]) -> Callable[..., Any]:
    """Return a function with the parameters of an options class, which calls `run` with an instance of it."""
    spelled, parameters = spellings(options), signature(options)

    def call(*values: Any, **named: Any) -> Any:
        bound = parameters.bind(*values, **named)
        bound.apply_defaults()
        given = bound.arguments
        for name, spelling in spelled.items():  # cyclopts lets *arguments be none
            if parameters.parameters[name].kind is inspect.Parameter.VAR_POSITIONAL and not given[name]:
                raise Tg4mmError(f"{spelling.metavar} is missing")
        made = {n: s.into(given[n]) if s.into else given[n] for n, s in spelled.items()}
        return run(options(**made))

    call.__signature__ = parameters  # type: ignore[attr-defined]
    call.__doc__ = inspect.getdoc(options)
    return call


def signature(options: type) -> inspect.Signature:
    """Return the parameters of an options class, annotated for cyclopts."""
    fields = options.__dataclass_fields__  # type: ignore[attr-defined]
    return inspect.Signature([_parameter(name, fields[name], s) for name, s in spellings(options).items()])


def _parameter(name: str, field: Any, spelling: Spelling) -> inspect.Parameter:
    kind = spelling.given or field.type
    default = field.default
    if spelling.given is not None:
        default = () if get_origin(kind) is tuple else spelling.initial
    is_argument = spelling.is_argument
    is_many = is_argument and get_origin(kind) is tuple
    if is_many:
        kind = get_args(kind)[0]
    has_default = default is not REQUIRED and not is_argument
    shown = _shown(default, spelling) if has_default else ""
    note = Parameter(
        name=spelling.metavar if is_argument else spelling.name or f"--{name.replace('_', '-')}",
        help=spelling.about,
        negative=spelling.off,
        show_default=(lambda value: shown) if shown else False,
        validator=[] if spelling.at_least is None else [Number(gte=spelling.at_least)],
        show_choices=False,
        allow_leading_hyphen=kind in _TEXTS,  # "-3,4 5,6" are corners of a polygon
        metavar=None if is_argument else _metavar(kind, spelling),
    )
    place = inspect.Parameter.POSITIONAL_ONLY if is_argument else inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(
        name,
        # several arguments may stand on both sides of options, which cyclopts allows for *arguments alone
        inspect.Parameter.VAR_POSITIONAL if is_many else place,
        annotation=Annotated[kind, note],
        default=default if has_default else inspect.Parameter.empty,
    )


def _metavar(kind: Any, spelling: Spelling) -> str | None:
    """Return the placeholder of the value in --help: unit, choices, or the type of one of several; None: its type."""
    one = kind if get_origin(kind) is tuple else next(iter(get_args(kind)), kind)
    if spelling.unit or spelling.metavar:
        return spelling.unit.upper() or spelling.metavar
    if isinstance(one, EnumMeta):
        return "|".join(map(str, one))
    return get_args(one)[0].__name__.upper() if get_origin(one) is tuple else None


def _shown(default: Any, spelling: Spelling) -> str:
    """Return the default as --help shows it; "" if the text names it, or if the option is off or not given."""
    if "[default:" in spelling.about or default is None or default == () or default is False or default == "":
        return ""
    if default is True:
        return (spelling.name or "on").removeprefix("--")
    text = (
        default.value if isinstance(default, Enum) else f"{default:g}" if type(default) is float else default
    )
    return f"{text} {spelling.unit}".strip()


def joined_bands(words: Sequence[str]) -> list[str]:
    """Join the two values of each --band: ["--band", "3", "5"] becomes ["--band", "3 5"].

    A value that is missing is never taken from another option.
    """
    joined: list[str] = []
    rest = list(words)
    while rest:
        token = rest.pop(0)
        if token == "--":
            return [*joined, token, *rest]
        option, equals, value = token.partition("=")
        if option != "--band":
            joined.append(token)
            continue
        values = [value] if equals else []
        while rest and len(values) < 2 and values != [AUTO] and not _is_option(rest[0]):
            values.append(rest.pop(0))
        joined.append(f"{option}={' '.join(values)}")
    return joined


def _is_option(token: str) -> bool:
    """Return whether it is another option, not a value: a negative number is a value, if a bad one."""
    return token.startswith("-") and not token[1:2].isdigit() and token[1:2] != "."


def message_of(error: CycloptsError, words: Sequence[str]) -> str:
    """The error about the words of a command line in one line, with the command whose --help says more."""
    where = " ".join(("tg4mm", *(error.command_chain or ())))
    if isinstance(error, UnusedCliTokensError):
        text = f"unexpected argument {' '.join(map(repr, error.unused_tokens or ()))}"
    elif isinstance(error, MissingArgumentError) and error.argument and error.argument.name not in words:
        text = f"{error.argument.name} is missing"
    else:
        text = " ".join(str(error).partition("Available commands")[0].split()).rstrip(".")
    return f"{text} (see {where} --help)"


class PlainHelp:
    """Help as plain text in two columns, which any terminal, pipe and screen reader shows."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print the arguments, options or commands."""
        if not panel.entries:
            return
        lines = [f"{panel.title}:"]
        for entry in panel.entries:
            lines += _entry_lines(entry, panel.format == "parameter", _width())
        print("\n".join(lines), end="\n\n", file=sys.stdout)

    def render_usage(self, console: Any, options: Any, usage: Any) -> None:
        """Print the line of usage."""
        print(f"Usage: {str(usage).strip()}", end="\n\n", file=sys.stdout)

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print what the command does, its paragraphs wrapped."""
        paragraphs = inspect.cleandoc(_plain(description)).split("\n\n")
        filled = (textwrap.fill(" ".join(p.split()), _width()) for p in paragraphs)
        print("\n\n".join(filled), end="\n\n", file=sys.stdout)


def _plain(text: Any) -> str:
    return str(getattr(text, "primary_renderable", text) or "")


def _width() -> int:
    return min(shutil.get_terminal_size().columns, _WIDEST)


def _entry_lines(entry: HelpEntry, is_parameter: bool, width: int) -> list[str]:
    labels = entry.display_labels_with_metavar if is_parameter else entry.display_labels
    parts = [_plain(entry.description)]
    parts += [f"[default: {entry.default}]"] if entry.default else []
    parts += ["[required]"] if entry.required and is_parameter else []
    label = " " * _INDENT + ", ".join(labels)
    text = textwrap.wrap(" ".join(filter(None, parts)), width - _COLUMN) or [""]
    text = [" " * _COLUMN + line for line in text]
    if len(label) <= _COLUMN - 2:
        return [label + text[0][len(label) :], *text[1:]]
    return [label, *text]
