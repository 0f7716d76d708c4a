"""The options --band, --alpha, --method and --filter, shared by the commands that magnify."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from tg4mm.core.choices import Filter, Method
from tg4mm.core.errors import Tg4mmError

if TYPE_CHECKING:
    from tg4mm.core.filters import TemporalFilter
    from tg4mm.core.magnification import Magnification
    from tg4mm.run import Run

_LOG = logging.getLogger("tg4mm")
AUTO = "auto"  # the band around the strongest vibration that the run found


class BandsCommand(TyperCommand):
    """A command whose --band takes two values and may be repeated, which typer's types cannot say."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the two values of each --band to one."""
        return super().parse_args(ctx, joined_bands(args))


def joined_bands(args: Sequence[str]) -> list[str]:
    """["--band", "3", "5"] becomes ["--band", "3 5"]. A value that is missing is never made up of another option."""
    joined: list[str] = []
    rest = list(args)
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
        joined += [option, " ".join(values)]
    return joined


def _is_option(token: str) -> bool:
    """Whether it is another option, not a value: a negative number is a value, if a bad one."""
    return token.startswith("-") and not token[1:2].isdigit() and token[1:2] != "."


BandOption = Annotated[
    list[str] | None,
    typer.Option(
        "--band",
        metavar="LO HI | auto",
        help="Magnify only frequencies LO ≤ f ≤ HI, Hz; may be repeated. auto: a band around the strongest vibration. "
        "[default: all]",
    ),
]
EmptyBandOption = Annotated[
    bool, typer.Option("--allow-empty-band", help="Accept a --band in which no motion was found.")
]
MethodOption = Annotated[
    Method | None,
    typer.Option(
        help="modal: scales the modes. linear: filters each Gaussian's motion over time. phase: shifts the phases of "
        "feature planes (presets paper and paper-tuned only). [default: modal; with the preset paper phase, with "
        "paper-tuned linear]"
    ),
]
FilterOption = Annotated[
    Filter | None,
    typer.Option(
        help="Temporal filter of linear and phase. published: as in the TG4MM paper, even length, half a sample early. "
        "[default: zero-phase]"
    ),
]


def parse_bands(texts: Sequence[str] | None) -> list[tuple[float, float] | None]:
    """`"3 5"` as (3.0, 5.0), `"auto"` as None. Raises Tg4mmError naming what is neither."""
    bands: list[tuple[float, float] | None] = []
    for text in texts or ():
        if text == AUTO:
            bands.append(None)
            continue
        try:
            low, high = (float(part) for part in text.split())
        except ValueError:
            raise Tg4mmError(f"--band {text!r} is neither two frequencies in Hz, LO HI, nor {AUTO}") from None
        bands.append((low, high))
    return bands


def known_bands(run: Run, bands: Sequence[tuple[float, float] | None]) -> list[tuple[float, float]]:
    """Resolve the bands; the band chosen for `auto` is reported. Raises Tg4mmError if the run has no vibration."""
    if None not in bands:
        return [band for band in bands if band is not None]
    from tg4mm.show.result.requested import auto_band

    auto, line = auto_band(run)
    _LOG.info(line)
    return [auto if band is None else band for band in bands]


def check_magnified(run: Run, plan: Magnification, allow_empty: bool) -> None:
    """Raise Tg4mmError for a band without motion, unless allowed."""
    from tg4mm.show.result.requested import refuse_empty

    if not allow_empty:
        refuse_empty(run, plan)


def warn_too_far(run: Run, plan: Magnification) -> None:
    """Say where motion is shown reversed, or goes further than it holds."""
    from tg4mm.show.result.requested import how_sure, reversed_motion, too_far

    for line in (reversed_motion(plan), too_far(run, plan), *how_sure(run, plan)):
        if line is not None:
            _LOG.warning(line)


def check_paired(alphas: Sequence[float], bands: Sequence[object]) -> None:
    """Raises Tg4mmError where there is not one alpha for each band."""
    if len(alphas) != max(len(bands), 1):
        need = "each band needs its own" if bands else "without --band there is one"
        raise Tg4mmError(f"--alpha is given {_times(alphas)}, --band {_times(bands)}: {need}")


def magnified(
    alphas: Sequence[float],
    bands: Sequence[tuple[float, float]],
    method: Method | None = None,
    filter: TemporalFilter | None = None,
) -> Magnification:
    """What the options ask for: one α for each band, or one of all frequencies."""
    from tg4mm.core.magnification import BandGain, Magnification

    gains = tuple(BandGain(*b, a) for b, a in zip(bands, alphas, strict=False))
    name = None if method is None else method.value
    return Magnification(gains, 0.0 if gains else alphas[0], name, filter)


def temporal_filter(kind: Filter | None, bands: Sequence[object]) -> TemporalFilter | None:
    """The filter asked for. Raises Tg4mmError where there is no band to filter by."""
    if kind is not None and not bands:
        raise Tg4mmError(f"--filter {kind.value} goes with --band: without one nothing is filtered")
    from tg4mm.core.filters import TemporalFilter

    return None if kind is None else TemporalFilter(kind.value)


def _times(given: Sequence[object]) -> str:
    return f"{len(given)} time{'' if len(given) == 1 else 's'}"
