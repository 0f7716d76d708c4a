"""Options of the command line as fields of dataclasses: name, default, unit and meaning of each are written once.

Each room has those of its commands in its module `options`; `tg4mm/cli/generated.py` makes commands of them. Settings
of a stage are listed by `tg4mm train --list-settings` and looked up by `--set`.
Needs Python's library alone, so that `tg4mm --help` starts at once.
"""

import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.core.choices import Filter, MagnificationMethod
from tg4mm.core.digits import aligned
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import require

if TYPE_CHECKING:
    from tg4mm.core.magnification import TemporalFilter
    from tg4mm.core.regions import Regions


REQUIRED = dataclasses.MISSING
AUTO = "auto"  # the band around the strongest vibration that the run found
OPTION = "option"  # the key of a field's metadata
Band = tuple[float, float]  # low and high, Hz
_MOST_TIMESTEPS = 1_000_000  # a range is made before the run says how many it has
RUN = "A run folder made by tg4mm train."
ALPHA = "Magnification: a displacement δ becomes (1 + alpha) δ"


@dataclass(frozen=True)
class Spelling:
    """An option's form on the command line.

    `given` is the type on the command line where it differs from the field's; `into` then makes the field's value of it
    and raises Tg4mmError for a value that cannot be.
    """

    about: str
    name: str = ""  # "" for --field-name
    metavar: str = ""  # "" for the type's name
    unit: str = ""  # in place of `metavar`, and after the default
    off: str = ""  # the spelling that turns a switch off, such as --no-video
    given: Any = None
    into: Callable[[Any], Any] | None = None
    initial: Any = None  # the default on the command line, where `given` is another type
    at_least: int | None = None
    is_argument: bool = False


def option(default: Any, about: str, **spelling: Any) -> Any:
    """Return a dataclass field that is an option: its default, its meaning, and its spelling.

    The default REQUIRED means that there is none, `dict` an empty dictionary.
    """
    metadata = {OPTION: Spelling(about, **spelling)}
    if default is dict:
        return dataclasses.field(default_factory=dict, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def argument(metavar: str, about: str, **spelling: Any) -> Any:
    """Return a dataclass field that is a positional argument, shown as `metavar`."""
    return dataclasses.field(metadata={OPTION: Spelling(about, "", metavar, is_argument=True, **spelling)})


def spellings(options: type) -> dict[str, Spelling]:
    """Return the fields of an options class that the command line has, arguments first."""
    fields = {f.name: f.metadata[OPTION] for f in dataclasses.fields(options) if OPTION in f.metadata}
    return dict(sorted(fields.items(), key=lambda item: not item[1].is_argument))


def parse_bands(texts: Sequence[str]) -> tuple[Band | None, ...]:
    """Parse bands: `"3 5"` as (3.0, 5.0), `"auto"` as None. Raises Tg4mmError naming what is neither."""
    bands: list[Band | None] = []
    for text in texts:
        if text == AUTO:
            bands.append(None)
            continue
        try:
            low, high = (float(part) for part in text.split())
        except ValueError:
            raise Tg4mmError(f"--band {text!r} is neither two frequencies in Hz, LO HI, nor {AUTO}") from None
        bands.append((low, high))
    return tuple(bands)


def parse_band(texts: Sequence[str]) -> Band | None:
    """Parse at most one band, None without any. Raises Tg4mmError for several, and for `auto`."""
    bands = parse_bands(texts)
    if len(bands) > 1 or None in bands:
        raise Tg4mmError("--band is given once, as two frequencies in Hz, LO HI")
    return bands[0] if bands else None


def parse_alphas(text: str | None) -> tuple[float, ...] | None:
    """Parse `5,10,20` as numbers. Raises Tg4mmError naming the part that is none."""
    if text is None:
        return None
    numbers = []
    for part in text.split(","):
        try:
            numbers.append(float(part))
        except ValueError:
            raise Tg4mmError(f"--alphas {text!r}: {part!r} is not a number") from None
    return tuple(numbers)


def parse_settings_texts(pairs: Sequence[str]) -> Mapping[str, str]:
    """Parse `key=value` texts. Raises Tg4mmError for a text without `=`, or a key given twice."""
    settings: dict[str, str] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise Tg4mmError(f"--set {pair!r} is not of the form key=value")
        if key.strip() in settings:
            raise Tg4mmError(f"--set {key.strip()} is given twice")
        settings[key.strip()] = text.strip()
    return settings


def parse_timesteps(text: str | None) -> list[int] | None:
    """Parse `"0-9,12"` as [0, …, 9, 12]. Raises Tg4mmError naming what is no timestep."""
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


def read_drawn(path: Path | None) -> "Regions | None":
    """Read a file of regions, None without one. Raises RegionError."""
    from tg4mm.core.regions import read_regions

    return None if path is None else read_regions(path)


class Device(StrEnum):
    """The device of tensors."""

    cpu = "cpu"
    cuda = "cuda"


def device_option() -> Any:
    """Return the option --device."""
    return option(Device.cpu, "cuda needs an NVIDIA GPU and the extra `cuda` (gsplat).")


def bands_option() -> Any:
    """Return the option --band of commands that magnify: bands, or None for `auto`."""
    about = (
        "Magnify only frequencies LO ≤ f ≤ HI, Hz; may be repeated. auto: a band around the strongest vibration. "
        "[default: all]"
    )
    return option((), about, name="--band", metavar="LO HI | auto", given=tuple[str, ...], into=parse_bands)


def band_option(about: str) -> Any:
    """Return the option --band of commands that take one band."""
    return option(None, about, metavar="LO HI", given=tuple[str, ...], into=parse_band)


def settings_option(about: str) -> Any:
    """Return the option --set."""
    return option(
        dict, about, name="--set", metavar="KEY=VALUE", given=tuple[str, ...], into=parse_settings_texts
    )


def regions_option() -> Any:
    """Return the option --regions."""
    about = "Regions and a scale drawn with tg4mm view (JSON)."
    return option(None, about, metavar="FILE", given=Path | None, into=read_drawn)


def empty_band_option() -> Any:
    """Return the option --allow-empty-band."""
    return option(False, "Accept a --band in which no motion was found.")


@dataclass(frozen=True, kw_only=True)
class MagnifyOptions:
    """Bands, method and filter of commands that magnify."""

    bands: tuple[Band | None, ...] = bands_option()
    method: MagnificationMethod | None = option(
        None,
        "modal: scales the modes. linear: filters each Gaussian's motion over time. phase: shifts the phases of "
        "feature planes (presets paper and paper-tuned only). [default: modal; phase for the preset paper, linear "
        "for paper-tuned]",
    )
    filter: Filter | None = option(
        None,
        "Temporal filter for --method linear and phase. published: the filter of the TG4MM paper, whose length is even "
        "and whose output is half a sample early. "
        "[default: zero-phase]",
    )
    allow_empty_band: bool = empty_band_option()

    @property
    def temporal_filter(self) -> "TemporalFilter | None":
        """The chosen filter. Raises Tg4mmError where there is no band to filter by."""
        if self.filter is None:
            return None
        if not self.bands:
            raise Tg4mmError(f"--filter {self.filter} needs --band: without a band nothing is filtered")
        from tg4mm.core.magnification import TemporalFilter

        return TemporalFilter(self.filter.value)


def setting(default: Any, about: str, unit: str = "") -> Any:
    """A field of a settings' dataclass: its default, what it means, and its unit, "" for a plain number."""
    return dataclasses.field(default=default, metadata={"about": about, "unit": unit})


def of_file(kind: type, values: Any, where: str, error: type[Tg4mmError]) -> Any:
    """Build a settings dataclass from the values that a file holds.

    Raises `error` for an unknown name, as from another version, and for a value of the wrong type.
    """
    require(where, values, dict, error)
    fields = {field.name: type(field.default) for field in dataclasses.fields(kind)}
    for name, value in values.items():
        if name not in fields:
            raise error(f"{where}.{name} is a setting that this version of tg4mm does not have")
        require(f"{where}.{name}", value, fields[name], error)
    return kind(**values)


def listed(defaults: Mapping[str, Any]) -> list[str]:
    """A line for each setting of `{stage: configuration}`: name, default with unit, meaning."""
    rows = []
    for stage, config in defaults.items():
        for field in dataclasses.fields(config):
            value = getattr(config, field.name)
            text = str(value).lower() if isinstance(value, bool) else str(value) or "empty"
            unit = field.metadata.get("unit", "") if value != "" else ""
            rows.append((f"{stage}.{field.name}", f"{text} {unit}".strip(), field.metadata.get("about", "")))
    return aligned(rows)


def unknown(name: str, defaults: Mapping[str, Any]) -> Tg4mmError:
    """The error for a name that no setting has, with those that may be meant."""
    known = [
        f"{stage}.{field.name}" for stage, config in defaults.items() for field in dataclasses.fields(config)
    ]
    stage, _, key = name.rpartition(".")
    keys = dict.fromkeys(one.rpartition(".")[2] for one in known)
    close = [key] if key in keys else difflib.get_close_matches(key, keys, n=1, cutoff=0.7)
    meant = [one for one in known if one.rpartition(".")[2] in close]
    meant = [one for one in meant if one.startswith(f"{stage}.")] or meant
    question = f"did you mean {' or '.join(meant)}? " if meant else ""
    return Tg4mmError(
        f"setting {name!r} is unknown; {question}tg4mm train --list-settings lists all, with meaning, default and unit"
    )
