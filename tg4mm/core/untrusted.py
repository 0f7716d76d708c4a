"""JSON, YAML and .npz of unknown origin as plain data: what a file promises is checked first.

What tg4mm wrote may carry a digest of its other entries (`write_sealed`); it then is what was written, or is refused.
`JsonRecord` checks values where they are read, so that an error names file, key and value.
"""

import errno
import io
import json
import math
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.errors import CaptureError
from tg4mm.core.files import json_digest, write_json
from tg4mm.core.values import Number, check_form, shown

JSON_BYTES = 32 << 20  # 40,000 frames of a transforms.json; at worst some 25 times as much in memory
YAML_BYTES = 64 << 10  # a description is a page; PyYAML reads 30 KiB a second where it lacks libyaml
YAML_VALUES = 100_000  # aliases let a page stand for billions
NPZ_BYTES = 1 << 30  # unpacked, all arrays together
NPZ_ARRAYS = 100_000
DEPTH = 64  # lists and objects in each other
DIGITS = 20  # of a whole number; past that no 64 bits hold it
DEFLATE = 1032  # bytes, at most, that one byte packed by zlib stands for (zlib's technical notes)
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DEEP = f"is nested more than {DEPTH} deep"

DIGEST = "digest"


def read_json(path: Path, most: int = JSON_BYTES, finite: bool = False) -> Any:
    """The data of a JSON file in UTF-8. Raises ValueError as `parse_json` does, and OSError."""
    return parse_json(_text(path, most), most, finite)


def parse_json(text: str | bytes, most: int = JSON_BYTES, finite: bool = False) -> Any:
    """The data of a JSON text.

    Raises ValueError for a text that is longer than `most` or no JSON, has a key twice (the second would silently
    win), is nested deeper than DEPTH, or holds a whole number past DIGITS or half a surrogate pair; with `finite`,
    for NaN and infinity as well, which programs write into JSON though it has none.
    """
    if len(text) > most:
        raise ValueError(f"has more than {most} bytes")
    try:
        value = json.loads(text, object_pairs_hook=_without_repeats, parse_int=_whole)
    except RecursionError:
        raise ValueError(_DEEP) from None
    except json.JSONDecodeError as error:
        raise ValueError(f"line {error.lineno} is not JSON: {error.msg}") from None
    _check_values(value, math.inf, finite)
    return value


def read_yaml(path: Path) -> Any:
    """The data of a YAML file in UTF-8. Raises ValueError as `parse_yaml` does, OSError, ImportError."""
    return parse_yaml(_text(path, YAML_BYTES))


def parse_yaml(text: str) -> Any:
    """The data of a YAML text with PyYAML's safe loader. Raises ImportError where that is not installed.

    Raises ValueError for what `parse_json` refuses, for a text of more than YAML_BYTES, for tags (!!timestamp and
    the like, for which a description has no use), keys that are not text, and aliases that make more than
    YAML_VALUES values of it.
    """
    import yaml

    if len(text) > YAML_BYTES:
        raise ValueError(f"has more than {YAML_BYTES} bytes")
    loader = _yaml_loader()
    try:
        _check_events(yaml.parse(text, loader))
        value = yaml.load(text, loader)
    except yaml.YAMLError as error:
        mark, problem = (
            getattr(error, "problem_mark", None),
            getattr(error, "problem", None) or " ".join(str(error).split()),
        )
        if "nesting depth" in problem:  # of PyYAML 6.0.4's own limit, met before an event is handed out
            raise ValueError(_DEEP) from None
        raise ValueError(f"{f'line {mark.line + 1} ' if mark else ''}is not YAML: {problem}") from None
    _check_values(value, YAML_VALUES)
    return value


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, read-only. Raises ValueError and OSError.

    Refused are pickles, archives that unpack to more than NPZ_BYTES, any packing but zip's own two, and arrays
    whose size is not what their header says.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_archive(entries)
            return {entry.filename.removesuffix(".npy"): _array(archive.read(entry)) for entry in entries}
    except ValueError:
        raise
    # zipfile and numpy report damage by many types: zlib.error, EOFError, TokenError, an OSError of a place before 0
    except Exception as error:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:
            raise
        raise ValueError(_one_line(error)) from None


def _text(path: Path, most: int) -> str:
    with path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"has more than {most} bytes")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"is not UTF-8 text: {error.reason} at byte {error.start}") from None


def _whole(text: str) -> int:
    if len(text) > DIGITS:
        raise ValueError(f"holds a whole number of {len(text)} digits; expected at most {DIGITS}")
    return int(text)


def _without_repeats(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if not isinstance(key, str):
            raise ValueError(f"key {str(key)[:60]} is not text")
        if key in found:
            raise ValueError(f"key {key[:60]!r} is there twice")
        found[key] = value
    return found


def _check_values(value: Any, most: float, finite: bool = False) -> None:
    """Level by level, so that neither depth nor aliases cost more than they are allowed."""
    level, depth, seen = [value], 0, 0
    while level:
        seen, below = seen + len(level), []
        if seen > most:
            raise ValueError(f"stands for more than {most} values")
        for item in level:
            if depth >= DEPTH and isinstance(item, dict | list):
                raise ValueError(_DEEP)
            if isinstance(item, dict):
                below += [*item, *item.values()]
            elif isinstance(item, list):
                below += item
            elif isinstance(item, str):
                _check_text(item)
            elif isinstance(item, int) and abs(item) >= 10**DIGITS:  # YAML's; JSON's were counted as text
                raise ValueError(f"holds a whole number of more than {DIGITS} digits")
            elif finite and isinstance(item, float) and not math.isfinite(item):
                raise ValueError(f"holds {item}, which is no finite number")
        level, depth = below, depth + 1


def _check_text(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError:  # no file name, message or UTF-8 file can hold it
        raise ValueError(f"holds the text {ascii(text)[:60]}, which is not Unicode") from None


def _yaml_loader() -> Any:
    import yaml

    base = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

    class Loader(base):  # type: ignore[misc, valid-type, unused-ignore]
        """Plain data only, without repeated keys."""

    def mapping(loader: Any, node: Any) -> dict[str, Any]:
        # At once, not in SafeLoader's two steps for documents that refer to themselves: of no use here.
        pairs = [(loader.construct_object(k, True), loader.construct_object(v, True)) for k, v in node.value]
        return _without_repeats(pairs)

    Loader.add_constructor("tag:yaml.org,2002:map", mapping)
    return Loader


def _check_events(events: Iterable[Any]) -> None:
    """Refuse tags and depth before anything is constructed, since constructors trust tags."""
    depth = 0
    for event in events:
        if getattr(event, "tag", None):
            raise ValueError(f"line {event.start_mark.line + 1} has the tag {event.tag}; expected none")
        kind = type(event).__name__
        depth += kind in ("SequenceStartEvent", "MappingStartEvent")
        depth -= kind in ("SequenceEndEvent", "MappingEndEvent")
        if depth > DEPTH:
            raise ValueError(_DEEP)


def _check_archive(entries: list[zipfile.ZipInfo]) -> None:
    if len(entries) > NPZ_ARRAYS:
        raise ValueError(f"holds {len(entries)} arrays; expected at most {NPZ_ARRAYS}")
    total = sum(entry.file_size for entry in entries)
    if total > NPZ_BYTES:
        raise ValueError(f"unpacks to {total} bytes; expected at most {NPZ_BYTES}")
    for entry in entries:
        if not entry.filename.endswith(".npy"):
            raise ValueError(f"holds {entry.filename[:60]!r}, which is no array")
        if entry.compress_type not in _METHODS:
            raise ValueError(
                f"{entry.filename[:60]!r} is compressed by ZIP method {entry.compress_type}, which is not supported; "
                "write the file with numpy.savez or savez_compressed"
            )
        if entry.flag_bits & 1:
            raise ValueError(f"{entry.filename[:60]!r} is encrypted")
        if entry.file_size > DEFLATE * (entry.compress_size + 1):
            raise ValueError(
                f"{entry.filename[:60]!r} promises {entry.file_size} bytes, more than it can hold"
            )
    if len({entry.filename for entry in entries}) < len(entries):
        raise ValueError("holds two arrays of one name")


def _array(data: bytes) -> np.ndarray:
    """An array from the bytes of an .npy file, of format version 1.0, the one that numpy writes."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"an array has the format version {version}; expected (1, 0)")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.hasobject:
        raise ValueError("an array holds Python objects, which would be pickles")
    start = file.tell()
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ValueError(f"an array has {len(data) - start} bytes; its header says {dtype} {shape}")
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    flat = np.frombuffer(data, dtype, offset=start)
    if dtype.kind == "U":
        codes = flat.view(np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if ((codes > 0x10FFFF) | ((codes >= 0xD800) & (codes < 0xE000))).any():
            raise ValueError("an array holds a text that is not Unicode")
    return flat.reshape(shape, order="F" if fortran else "C")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write an object of JSON values with a digest of it, atomically."""
    write_json(path, {**values, DIGEST: json_digest(dict(values))})


def read_formed(path: Path, form: Mapping[Any, Any]) -> dict[str, Any]:
    """A JSON file of that form (`values`), without its digest.

    Raises ValueError of one line, without the file's name, for what is no JSON, not what was written, or of another
    form; and OSError.
    """
    values = read_json(path, finite=True)
    digest = values.pop(DIGEST, None) if isinstance(values, dict) else None
    if digest is not None and digest != json_digest(values):
        raise ValueError("is damaged or edited: its content is not what was written")
    check_form(values, form)
    return dict(values)


def as_number(value: Any) -> float:
    """A JSON number as float, NaN for anything else (booleans and numbers past float's range too)."""
    return float(value) if Number().fits(value) else math.nan


@dataclass(frozen=True)
class JsonRecord:
    """A JSON object and where it came from; its getters raise CaptureError with both."""

    where: str  # file, and the part of it
    values: dict[str, Any]

    def error(self, key: str, expected: str) -> CaptureError:
        """Return a CaptureError with the value of `key` and the expected one."""
        if key not in self.values:
            return CaptureError(f"{self.where}: {key} is missing; expected {expected}")
        return CaptureError(f"{self.where}: {key} is {shown(self.values[key])}; expected {expected}")

    def has(self, key: str) -> bool:
        """Return whether `key` exists with a value other than null."""
        return self.values.get(key) is not None

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number with low < number < high."""
        rule = Number(low, high, above=True, below=True)
        if not rule.fits(self.values.get(key)):
            raise self.error(key, str(rule))
        return float(self.values[key])

    def whole(self, key: str, at_least: int) -> int:
        """A whole number of at least `at_least` (30.0 counts as whole)."""
        value = as_number(self.values.get(key))
        if not (value.is_integer() and value >= at_least):
            raise self.error(key, f"a whole number of at least {at_least}")
        return int(value)

    def text(self, key: str) -> str:
        """A string that is not empty."""
        value = self.values.get(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, "a non-empty string")
        return value


def read_record(path: Path) -> JsonRecord:
    """A JSON file whose top level is an object."""
    try:
        values = read_json(path)
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise CaptureError(f"{path}: is not valid JSON: {error}") from error
    if not isinstance(values, dict):
        raise CaptureError(f"{path}: holds {shown(values)}; expected a JSON object {{…}}")
    return JsonRecord(str(path), values)
