"""`tg4mm export`: a run in a format that other programs read."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.magnify import (
    BandOption,
    EmptyBandOption,
    FilterOption,
    MethodOption,
    check_magnified,
    check_paired,
    known_bands,
    magnified,
    parse_bands,
    temporal_filter,
    warn_too_far,
)
from tg4mm.core.errors import Tg4mmError


class Format(StrEnum):
    """File formats; docs/export.md describes them."""

    ply = "ply"
    ply_sequence = "ply-sequence"
    html = "html"
    gltf = "gltf"
    spz = "spz"
    usd = "usd"


class LowPass(StrEnum):
    """What is in the scales of exported Gaussians."""

    baked = "baked"
    none = "none"


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    out: Annotated[
        Path,
        typer.Option(
            help="Output file, or output folder for a sequence. With spz, a name ending in .spz writes the scene "
            "at rest, any other name a sequence folder."
        ),
    ],
    format: Annotated[
        Format,
        typer.Option(
            help="ply: the splat file, a 3DGS PLY that also holds the motion. "
            "ply-sequence: a static 3DGS PLY for every timestep. "
            "html: one page that plays the run in any browser (docs/web.md). "
            "gltf: a .glb with KHR_gaussian_splatting and an animation. "
            "spz: compressed, without motion: the scene at rest or one file for every timestep of a period. "
            "usd: a ParticleField3DGaussianSplat with a sample for every timestep. docs/export.md compares them."
        ),
    ] = Format.ply,
    alpha: Annotated[
        list[float] | None,
        typer.Option(
            help="Magnification: a displacement δ becomes (1 + alpha) δ; with several --band one for each. Not for "
            "ply and html, which hold the motion itself. [default: 0]"
        ),
    ] = None,
    band: BandOption = None,
    method: MethodOption = None,
    filter: FilterOption = None,
    allow_empty_band: EmptyBandOption = False,
    timesteps: Annotated[
        str | None,
        typer.Option(
            metavar="A-B,C,…",
            help="Timesteps to write (sequences, usd). [default: all; spz: one period of the strongest vibration]",
        ),
    ] = None,
    low_pass: Annotated[
        LowPass,
        typer.Option(
            help="baked: each Gaussian is as wide as training drew it, 0.3 square pixels more than it was trained; for "
            "Blender, and for windows larger than the training pictures. none: scales as trained, for tools that add "
            "these 0.3 square pixels themselves, at the size of the training pictures. Not for html."
        ),
    ] = LowPass.baked,
) -> None:
    """Write a run as files for viewers and for Blender.

    Lengths are in scene units.
    """
    alphas, asked = alpha or [0.0], parse_bands(band)
    wanted = parse_timesteps(timesteps)
    rest = format is Format.spz and out.suffix.lower() == ".spz"
    options = {
        "--alpha": bool(alpha),
        "--band": bool(band),
        "--method": method is not None,
        "--filter": filter is not None,
        "--timesteps": wanted is not None,
    }
    _refuse(format, rest, [name for name, given in options.items() if given])
    if format is Format.html and low_pass is LowPass.none:
        raise Tg4mmError(
            "--low-pass none: not for html, which draws with a low-pass of its own; leave it out"
        )
    check_paired(alphas, asked)
    chosen_filter = temporal_filter(filter, asked)
    from tg4mm.run import Run
    from tg4mm.show.export import splat as plain
    from tg4mm.show.export.formats import export_gltf, export_spz, export_spz_sequence, export_usd
    from tg4mm.show.render.sequence import RenderRequest

    opened, baked = Run.open(run), low_pass is LowPass.baked
    if format is Format.ply:
        plain.export_ply(opened, out, baked)
    elif format is Format.html:
        from tg4mm.show.web.write import export_html

        export_html(opened, out)
    elif rest:
        export_spz(opened, out, baked)
        _say("spz holds no motion: this is the scene at rest; a folder as --out takes a sequence")
    else:
        plan = magnified(alphas, known_bands(opened, asked), method, chosen_filter)
        request = RenderRequest(plan).checked()
        check_magnified(opened, plan, allow_empty_band)
        warn_too_far(opened, plan)
        if format is Format.gltf:
            export_gltf(opened, out, plan, baked)
        elif format is Format.usd:
            export_usd(opened, out, request, wanted, baked)
        elif format is Format.spz:
            written = export_spz_sequence(opened, out, request, wanted, baked)
            _say(f"spz holds no motion: {written} files, one for each timestep")
        else:
            plain.export_ply_sequence(opened, out, request, wanted, baked)
    typer.echo(str(out))


_TAKEN = {
    Format.ply_sequence: ("--alpha", "--band", "--method", "--filter", "--timesteps"),
    Format.spz: ("--alpha", "--band", "--method", "--filter", "--timesteps"),
    Format.usd: ("--alpha", "--band", "--method", "--filter", "--timesteps"),
    Format.gltf: ("--alpha", "--band"),
}
_HOLDS = {
    Format.ply: "a splat file contains the motion itself",
    Format.html: "a page contains the motion itself",
    Format.gltf: "a .glb contains complete modes",
}


def _refuse(format: Format, rest: bool, given: Sequence[str]) -> None:
    """Raise Tg4mmError for an option that the format has no use for."""
    taken = () if rest else _TAKEN.get(format, ())
    wrong = [name for name in given if name not in taken]
    if not wrong:
        return
    reason = "a .spz file contains the scene at rest; give a folder" if rest else _HOLDS[format]
    formats = [one.value for one, names in _TAKEN.items() if all(name in names for name in wrong)]
    verb = "belongs" if len(wrong) == 1 else "belong"
    raise Tg4mmError(f"{' and '.join(wrong)} {verb} to --format {', '.join(formats)}; {reason}")


_MOST_TIMESTEPS = 1_000_000  # a range is made before the run says how many it has


def parse_timesteps(text: str | None) -> list[int] | None:
    """`"0-9,12"` as [0, …, 9, 12]. Raises Tg4mmError naming what is no timestep."""
    if text is None:
        return None
    wanted: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            low, high = int(first), int(last or first)
        except ValueError:
            low, high = 0, -1
        if not 0 <= low <= high < _MOST_TIMESTEPS:
            raise Tg4mmError(
                f"--timesteps {text!r}: {part!r} is neither a timestep such as 7 nor a range such as 0-9"
            )
        wanted += range(low, high + 1)
    return wanted


def _say(line: str) -> None:
    typer.echo(line, err=True)
