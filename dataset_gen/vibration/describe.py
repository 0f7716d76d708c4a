"""The motion description: modes from a YAML or JSON file, and back to plain data."""

import sys
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

from tg4mm.core.untrusted import read_json, read_yaml

from ..errors import GenerateError
from . import values
from .fields import RANDOM, Drift, Field, Group, Jiggle, Mode, Rock, Translate, Twist
from .structures import Bending, Membrane, Plate, Wave
from .values import DampedSinusoid, Ramp

_ALWAYS = ("name", "kind", "parts", "magnified")
_VIBRATES = ("frequency", "amplitude", "amplitude_px", "phase", "phases", "decay")
_LARGEST = 1 << 20  # bytes of JSON: a description is a page
KINDS: dict[str, type[Any]] = {
    cls.kind: cls for cls in (Translate, Rock, Twist, Bending, Membrane, Plate, Wave, Jiggle, Group, Drift)
}


@dataclass(frozen=True)
class MotionDescription:
    """The modes of a scene; the first is the main one, which names the dataset.

    Raises GenerateError if there is none, if two have one name, or if the first does not vibrate.
    """

    modes: tuple[Mode, ...]
    source: str = field(default="motion", compare=False)  # what messages call it: the file

    def __post_init__(self) -> None:
        if not self.modes:
            raise GenerateError(f"{self.source}: modes is empty: nothing would move")
        names = [mode.name for mode in self.modes]
        for name in names:
            if names.count(name) > 1:
                raise GenerateError(f"{self.source}: two modes have the name {name!r}")
        if not self.modes[0].frequency_hz:
            raise GenerateError(
                f"{self.source}: mode {names[0]!r} is the first, which needs a frequency; "
                f"its kind is {self.modes[0].kind}"
            )

    @property
    def main(self) -> Mode:
        """The first mode: its frequency_hz, and one of amplitude and amplitude_px, name the dataset."""
        return self.modes[0]

    def with_main(
        self,
        frequency_hz: float | None = None,
        amplitude: float | None = None,
        amplitude_px: float | None = None,
    ) -> "MotionDescription":
        """The same with another frequency or amplitude of the main mode; None leaves what is described.

        Modes of the main one's frequency go along, their amplitudes in proportion: together they are one motion.
        A mode whose amplitude is not given in the same unit as the main one's keeps it.
        """
        if amplitude is not None and amplitude_px is not None:
            raise GenerateError(
                f"--amplitude {amplitude:g} and --amplitude-px {amplitude_px:g} cannot be used together"
            )
        if frequency_hz is not None:
            _option("--frequency", frequency_hz)
        wanted = _option("--amplitude", amplitude), _option("--amplitude-px", amplitude_px)
        return replace(self, modes=tuple(self._along(mode, frequency_hz, wanted) for mode in self.modes))

    def _along(
        self, mode: Mode, frequency_hz: float | None, wanted: tuple[float | None, float | None]
    ) -> Mode:
        """A mode after the main one got another frequency, or one of the amplitudes `wanted` (units, pixels)."""
        main = self.main
        if mode.frequency_hz != main.frequency_hz:
            return mode
        share = _ratio(mode.amplitude, main.amplitude) or _ratio(mode.amplitude_px, main.amplitude_px)
        if wanted != (None, None) and share:
            size, pixels = (None if w is None else share * w for w in wanted)
            mode = replace(mode, amplitude=size, amplitude_px=pixels)
        if frequency_hz is not None:
            mode = replace(mode, law=replace(_vibration(mode), frequency_hz=frequency_hz))
        return mode

    def to_json(self) -> dict[str, Any]:
        """Plain data with the keys of the file; `from_json` gives an equal description."""
        return {"modes": [_mode_data(mode) for mode in self.modes]}

    @classmethod
    def from_json(cls, data: Any, source: str = "motion") -> "MotionDescription":
        """Build the description from a file's data. Raises GenerateError with the mode and the key."""
        try:
            _check_keys(data, ("modes",), "a motion description")
            if not isinstance(data.get("modes"), list):
                raise ValueError(f"modes {values.shown(data.get('modes'))} is not a list")
        except ValueError as error:
            raise GenerateError(f"{source}: {error}") from None
        modes = []
        for number, entry in enumerate(data["modes"]):
            try:
                modes.append(_mode(entry))
            except ValueError as error:
                raise GenerateError(f"{source}: mode {_called(entry, number)}: {error}") from None
        return cls(tuple(modes), source)


def read_motion(path: Path) -> MotionDescription:
    """The description in a YAML or JSON (.json) file. Raises GenerateError, one line with file, mode and key."""
    return MotionDescription.from_json(load(Path(path)), Path(path).name)


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a / b


def _option(option: str, value: float | None) -> float | None:
    if value is None:
        return None
    try:
        return values.positive(value)
    except ValueError as error:
        raise GenerateError(f"{option} {error}") from None


def _vibration(mode: Mode) -> DampedSinusoid:
    assert isinstance(mode.law, DampedSinusoid)  # a description's first mode is, and what has its frequency
    return mode.law


def _called(entry: Any, number: int) -> str:
    name = entry.get("name") if isinstance(entry, dict) else None
    return values.shown(name) if isinstance(name, str) else str(number + 1)


def _check_keys(data: Any, allowed: tuple[str, ...], what: str) -> None:
    if not isinstance(data, dict):
        raise ValueError(f"{values.shown(data)} is not a mapping of keys to values")
    for key in data:
        if key not in allowed:
            raise ValueError(f"key {values.shown(key)} is not one of {what}: {', '.join(allowed)}")


def _mode(data: Any) -> Mode:
    if not isinstance(data, dict):
        raise ValueError(f"{values.shown(data)} is not a mapping of keys to values")
    for key in ("name", "kind"):
        if data.get(key) is None:
            raise ValueError(f"{key} is missing")
    name, kind = (_read(data, key, values.text) for key in ("name", "kind"))
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r} is not one of {', '.join(KINDS)}")
    drifts = kind == "drift"
    common = (*_ALWAYS, "rate") if drifts else (*_ALWAYS, *_VIBRATES)
    _check_keys(data, (*common, *keys(kind)), f"a mode of kind {kind}")
    mode = Mode(
        name=name, field=read_field(kind, data),
        law=Ramp() if drifts else DampedSinusoid(_needed(data, "frequency"), _read(data, "decay", values.positive)),
        parts=_read(data, "parts", values.texts) or (),
        magnified=_read(data, "magnified", values.truth_value, True),
    )  # fmt: skip
    return replace(mode, amplitude=_needed(data, "rate")) if drifts else _with_amplitude(mode, data)


def _with_amplitude(mode: Mode, data: Mapping[str, Any]) -> Mode:
    amplitude, pixels = (_read(data, key, values.positive) for key in ("amplitude", "amplitude_px"))
    if amplitude is not None and pixels is not None:
        raise ValueError(
            f"amplitude {amplitude:g} and amplitude_px {pixels:g} cannot both be given: remove one"
        )
    if amplitude is None and pixels is None:
        raise ValueError("amplitude is missing: amplitude (scene units) or amplitude_px (pixels) is needed")
    return replace(
        mode, amplitude=amplitude, amplitude_px=pixels, phase=_read(data, "phase", values.number, 0.0),
        phases=_read(data, "phases", _phases, ()),
    )  # fmt: skip


def _read(data: Mapping[str, Any], key: str, reader: Any, default: Any = None) -> Any:
    """The value of an optional key; null is the same as absent."""
    if data.get(key) is None:
        return default
    try:
        return reader(data[key])
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _needed(data: Mapping[str, Any], key: str) -> float:
    if data.get(key) is None:
        raise ValueError(f"{key} is missing")
    return float(_read(data, key, values.positive))


def _phases(value: Any) -> tuple[tuple[str, float], ...] | str:
    if value == RANDOM:
        return RANDOM
    if not isinstance(value, dict) or not value:
        raise ValueError(f"{values.shown(value)} is neither {RANDOM!r} nor a mapping of parts to degrees")
    return tuple((values.text(glob), values.number(degrees)) for glob, degrees in value.items())


def _mode_data(mode: Mode) -> dict[str, Any]:
    data: dict[str, Any] = {"name": mode.name, "kind": mode.kind}
    if isinstance(mode.law, DampedSinusoid):
        data |= {"frequency": mode.law.frequency_hz, "decay": mode.law.decay_s}
        data |= {"amplitude": mode.amplitude, "amplitude_px": mode.amplitude_px, "phase": mode.phase}
        data |= {"phases": mode.phases if isinstance(mode.phases, str) else dict(mode.phases) or None}
    else:
        data |= {"rate": mode.amplitude}
    data |= {"parts": list(mode.parts) or None, "magnified": mode.magnified, **field_data(mode.field)}
    return {key: value for key, value in data.items() if value is not None}


def load(path: Path) -> Any:
    """The data in a YAML or JSON file (by its suffix, .json). Raises GenerateError."""
    try:
        return read_json(path, _LARGEST) if path.suffix.lower() == ".json" else read_yaml(path)
    except ImportError:
        raise GenerateError(
            f"{path} needs PyYAML, which this Python lacks: '{sys.executable}' -m pip install PyYAML, "
            "or write the same as .json"
        ) from None
    except OSError as error:
        raise GenerateError(f"{path} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise GenerateError(f"{path}: {' '.join(str(error).split())}") from None


def keys(kind: str) -> tuple[str, ...]:
    """Names of the fields of a kind, in order."""
    return tuple(f.name for f in fields(KINDS[kind]))


def read_field(kind: str, data: Mapping[str, Any]) -> Field:
    """A field from the values of its keys; null is the same as absent. Raises ValueError naming the key."""
    cls, values = KINDS[kind], {}
    hints = get_type_hints(cls, include_extras=True)
    for f in fields(cls):
        if data.get(f.name) is None:
            if f.default is MISSING:
                raise ValueError(f"{f.name} is missing: a mode of kind {kind} needs it")
            continue
        read = get_args(hints[f.name])[1]
        try:
            values[f.name] = read(data[f.name])
        except ValueError as error:
            raise ValueError(f"{f.name}: {error}") from None
    field: Field = cls(**values)
    return field


def field_data(field: Field) -> dict[str, Any]:
    """The values of a field's keys as plain data, without those that are absent."""
    return {name: _plain(value) for name, value in asdict(field).items() if value is not None}  # type: ignore[call-overload]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(v) for name, v in value.items()}
    return list(value) if isinstance(value, tuple) else value
