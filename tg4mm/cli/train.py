"""`tg4mm train`: Gaussians at rest, then their motion, from a dataset."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from tg4mm.cli.device import Device, DeviceOption
from tg4mm.cli.magnify import parse_bands
from tg4mm.core.errors import Tg4mmError

PresetOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="modal: one fit of modes to all timesteps. paper: TG4MM as published, a triplane for each "
        "timestep. paper-tuned: the same with changes that find more of the motion in less time "
        "(docs/paper.md). Packages may add presets: --list-settings lists all.",
    ),
]


SettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override one setting, e.g. space.iterations=3000; may be repeated. --list-settings lists them.",
    ),
]


def _list_settings(wanted: bool) -> None:
    if not wanted:
        return
    from tg4mm.core.settings import listed
    from tg4mm.run.preset import presets

    for preset, chosen in presets().items():
        typer.echo(f"--preset {preset}")
        typer.echo("\n".join(f"  {line}" for line in listed(chosen.defaults)))
    raise typer.Exit


def train(
    dataset: Annotated[
        Path,
        typer.Argument(metavar="DATASET", help="A dataset folder (docs/conventions.md lists the layouts)."),
    ],
    out: Annotated[Path, typer.Option(help="Run folder; an unfinished one is resumed.")],
    preset: PresetOption = "modal",
    device: DeviceOption = Device.cpu,
    settings: SettingsOption = None,
    band: Annotated[
        list[str] | None,
        typer.Option(
            "--band",
            metavar="LO HI",
            help="Frequency band in Hz in which motion is fitted even if no peak stands out, for "
            "records of one or two periods (--set motion.band). [default: significant peaks]",
        ),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="FILE | X,Y X,Y …",
            help="Where motion may be, in pixels of the one fixed camera: a PNG, white there, or a polygon's corners: "
            "--set motion.region. [default: everywhere]",
        ),
    ] = None,
    mask: Annotated[
        str | None,
        typer.Option(
            metavar="FILE | X,Y X,Y …",
            help="What counts in that camera's pictures, for the scene at rest and its motion: --set space.mask. "
            "[default: everything]",
        ),
    ] = None,
    list_settings: Annotated[
        bool,
        typer.Option(
            "--list-settings",
            callback=_list_settings,
            is_eager=True,
            help="Print the settings of all presets with default, unit and meaning, and exit.",
        ),
    ] = False,
) -> None:
    """Fit the scene at rest and its motion to a dataset.

    Defaults follow from the dataset's size, timesteps and views. The same command resumes a run that was stopped; for a
    finished run it prints the result again.
    """
    chosen = split_settings(settings or [])
    if band:
        chosen = with_setting(chosen, "motion.band", "--band", band_text(parse_bands(band)))
    for name, option, text in (("motion.region", "--region", region), ("space.mask", "--mask", mask)):
        if text is not None:
            chosen = with_setting(chosen, name, option, text)
    from tg4mm.run.train import train as train_run
    from tg4mm.show.result import lines_of, result_of

    run = train_run(dataset, out, preset, device.value, chosen)
    typer.echo("\n".join(lines_of(result_of(run))))


def band_text(bands: Sequence[tuple[float, float] | None]) -> str:
    """Of the setting motion.band. Raises Tg4mmError for `auto` and several bands."""
    if len(bands) != 1 or bands[0] is None:
        raise Tg4mmError("--band: training takes one band, two frequencies in Hz, LO HI")
    return "{:g} {:g}".format(*bands[0])


def with_setting(settings: dict[str, str], name: str, option: str, text: str) -> dict[str, str]:
    """The settings with one that has an option of its own. Raises Tg4mmError where it is set twice."""
    if name in settings:
        raise Tg4mmError(f"{option} and --set {name} exclude each other")
    return {**settings, name: text}


def split_settings(pairs: Sequence[str]) -> dict[str, str]:
    """`key=value` texts as a dictionary of texts.

    Raises Tg4mmError for a text without `=`, or a key given twice.
    """
    settings: dict[str, str] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise Tg4mmError(f"--set {pair!r} is not of the form key=value")
        if key.strip() in settings:
            raise Tg4mmError(f"--set {key.strip()} is given twice")
        settings[key.strip()] = text.strip()
    return settings
