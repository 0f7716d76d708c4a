"""`tg4mm evaluate`: a run against the ground truth of its dataset."""

from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.magnify import (
    BandOption,
    EmptyBandOption,
    FilterOption,
    MethodOption,
    check_magnified,
    known_bands,
    magnified,
    parse_bands,
    temporal_filter,
    warn_too_far,
)
from tg4mm.core.errors import Tg4mmError


def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by tg4mm train.")],
    alphas: Annotated[
        str | None,
        typer.Option(
            metavar="A,A,…", help="Magnification factors, e.g. 5,10,20,50. [default: all with ground truth]"
        ),
    ] = None,
    band: BandOption = None,
    method: MethodOption = None,
    filter: FilterOption = None,
    out: Annotated[Path | None, typer.Option(help="JSON file to write. [default: RUN/metrics.json]")] = None,
    lpips_weights: Annotated[
        list[Path] | None,
        typer.Option(help="Local file(s) with AlexNet and the LPIPS heads; LPIPS is left out without them."),
    ] = None,
    allow_empty_band: EmptyBandOption = False,
    device: DeviceOption = Device.cpu,
) -> None:
    """Score a run against its dataset's ground truth.

    Prints PSNR (dB), SSIM, FLIP and LPIPS on the test cameras, and the displacement error. Beside them stand the scores
    of "nothing moves" and, if the exact motion is known, of the ceiling. With --device cuda the GPU renders the
    pictures; metrics are computed on the CPU.
    """
    wanted, asked = parse_alphas(alphas), parse_bands(band)
    chosen_filter = temporal_filter(filter, asked)
    from tg4mm.fit.device import check_device
    from tg4mm.research.evaluate.run import evaluate_run
    from tg4mm.research.evaluate.wanted import check_alphas, format_table, target_file
    from tg4mm.run import Run

    check_device(device.value)
    opened = Run.open(run)
    largest = max(check_alphas(wanted, opened.dataset), default=0)
    bands = known_bands(opened, asked)
    plan = magnified([largest] * max(len(bands), 1), bands, method, chosen_filter)
    check_magnified(opened, plan, allow_empty_band)
    target_file(opened, out)  # raises where it cannot be written
    warn_too_far(opened, plan)
    metrics = evaluate_run(
        opened, wanted, out, plan, lpips_weights=lpips_weights or None, device=device.value
    )
    typer.echo(format_table(metrics), nl=False)


def parse_alphas(text: str | None) -> list[float] | None:
    """`5,10,20` as numbers. Raises Tg4mmError naming the part that is none."""
    if text is None:
        return None
    numbers = []
    for part in text.split(","):
        try:
            numbers.append(float(part))
        except ValueError:
            raise Tg4mmError(f"--alphas {text!r}: {part!r} is not a number") from None
    return numbers
