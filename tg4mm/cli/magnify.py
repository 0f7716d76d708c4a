"""The options --band, --alpha, --method and --filter, shared by the commands that magnify."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from tg4mm.errors import Tg4mmError

if TYPE_CHECKING:
    from tg4mm.magnify import BandGain, TemporalFilter


class Method(StrEnum):
    """How motion is magnified."""

    modal = "modal"
    linear = "linear"
    phase = "phase"


class Filter(StrEnum):
    """Temporal filters."""

    zero_phase = "zero-phase"
    ideal = "ideal"
    published = "published"


class BandsCommand(TyperCommand):
    """A command whose --band takes two values and may be repeated, which typer's types cannot say."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the two values of each --band to one."""
        return super().parse_args(ctx, joined_bands(args))


def joined_bands(args: Sequence[str]) -> list[str]:
    """["--band", "3", "5"] becomes ["--band", "3 5"]; what lacks a value stays as it is."""
    joined, rest = [], list(args)
    while rest:
        token = rest.pop(0)
        joined.append(token)
        if token == "--":
            return joined + rest
        if token == "--band" and len(rest) >= 2:
            joined.append(f"{rest.pop(0)} {rest.pop(0)}")
    return joined


BandOption = Annotated[
    list[str] | None,
    typer.Option(
        "--band", metavar="LO HI", help="Magnify only LO ≤ f ≤ HI, Hz; may be repeated. [default: all]"
    ),
]
MethodOption = Annotated[
    Method | None,
    typer.Option(
        help="modal: by modes. linear: filter what each Gaussian does. phase: the phases of feature planes "
        "(paper runs only). [default: modal; of paper runs phase, of paper-tuned linear]"
    ),
]
FilterOption = Annotated[
    Filter | None,
    typer.Option(
        help="Of linear and phase. published: even length, half a sample early. [default: zero-phase]"
    ),
]


def parse_bands(texts: Sequence[str] | None) -> list[tuple[float, float]]:
    """`"3 5"` as (3.0, 5.0). Raises Tg4mmError naming what are not two numbers."""
    bands = []
    for text in texts or ():
        try:
            low, high = (float(part) for part in text.split())
        except ValueError:
            raise Tg4mmError(f"--band {text!r} is not two frequencies in Hz, LO HI") from None
        bands.append((low, high))
    return bands


def paired(alphas: Sequence[float], bands: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """alpha, band and bands of a RenderRequest. Raises Tg4mmError where there is not one alpha for each band."""
    from tg4mm.magnify import BandGain

    if len(alphas) != max(len(bands), 1):
        need = "each band needs its own" if bands else "without --band there is one"
        raise Tg4mmError(f"--alpha is given {_times(alphas)}, --band {_times(bands)}: {need}")
    if len(bands) <= 1:
        return {"alpha": alphas[0], "band": bands[0] if bands else None}
    gains: tuple[BandGain, ...] = tuple(BandGain(*b, a) for b, a in zip(bands, alphas, strict=True))
    return {"bands": gains}


def temporal_filter(kind: Filter | None, bands: Sequence[object]) -> TemporalFilter | None:
    """The filter asked for. Raises Tg4mmError where there is no band to filter by."""
    if kind is not None and not bands:
        raise Tg4mmError(f"--filter {kind.value} goes with --band: without one nothing is filtered")
    from tg4mm.magnify import TemporalFilter

    return None if kind is None else TemporalFilter(kind.value)


def _times(given: Sequence[object]) -> str:
    return f"{len(given)} time{'' if len(given) == 1 else 's'}"
