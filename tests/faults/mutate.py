"""Seeded mutations of files: what disks, editors, other programs and hostile people do to them.

A mutation takes a file's bytes and a random generator and gives other bytes; the same generator gives the same.
Those of bytes fit any file; the others know a format well enough to get past its first check.
"""

import copy
import json
import random
import re
from collections.abc import Callable
from typing import Any

Mutation = Callable[[bytes, random.Random], bytes]

WHOLE = (0, 1, -1, 127, 255, 1 << 15, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, (1 << 63) - 1, 10**9)
DEEP, ENDLESS, TWICE = "\ue000deep", "\ue000endless", "\ue000twice"  # markers, replaced in the text
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 0.5, -0.0, 1e-320, 1e308, 10**9, 10**12, 2**63, 10**400),
    *(float("nan"), float("inf"), float("-inf"), DEEP, ENDLESS),
    *("", " ", "x", "nan", "1", "0x10", "../../../../etc/passwd", "/etc/passwd", "C:\\x.png", "a\0b", "\ud800", "%s"),
    *("a\nb", "a" * 300, "a" * 5000, ".", "..", "r_000", "./train/r_001", "é", "1/0", "-1/3", "2020-02-30"),
    *([], {}, [[]], [0], [1, 2], [1, 2, 3], [None], ["x"], [[1]], {"x": 1}, {"": {}}, [0] * 1000, [float("nan")] * 3),
)  # fmt: skip
YAML_TEXTS = (
    *('!!bool "foo"', '!!int ""', "!!timestamp x", "!!map [1]", "!!python/object/apply:os.system [id]"),
    *("!!binary x", "&a [*a]"),
    *("*nowhere", "{? [1] : 2}", "<<: {a: 1}", "=", "~", ".nan", ".inf", "-.inf", "1e999", "2001-99-99"),
    *("0b", "0x_", "1:99:99", "'", '"', "|", ">", "%YAML 9.9", "---", "...", "\t", "[", "{"),
    *("- ", ": ", "# ", "!", "@", "9" * 5000, "[" * 200, "{a: " * 200, "\ufeff", "\x00", "\x85", "a" * 3000),
)  # fmt: skip


def of_bytes(data, rng):
    """One to four small damages, wherever they fall."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_BYTES)(data, rng)
    return data


def _flip(data, rng):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _truncate(data, rng):
    return data[: rng.randrange(len(data) + 1)]


def _slice(data, rng):
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.choice((1, 2, 4, 8, 32, 256, 4096)))


def _delete(data, rng):
    a, b = _slice(data, rng)
    return data[:a] + data[b:]


def _repeat(data, rng):
    a, b = _slice(data, rng)
    return data[:b] + data[a:b] * rng.choice((1, 2, 100)) + data[b:]


def _insert(data, rng):
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.choice((1, 2, 4, 16, 256))) + data[at:]


def _blank(data, rng):
    a, b = _slice(data, rng)
    return data[:a] + bytes([rng.choice((0, 255))]) * (b - a) + data[b:]


def _number(data, rng):
    """A whole number of 1 to 8 bytes with an extreme value, most often near the start, where headers are."""
    size = rng.choice((1, 2, 4, 8))
    if len(data) < size:
        return data
    most = len(data) - size
    at = rng.randint(0, min(most, 200)) if rng.random() < 0.7 else rng.randint(0, most)
    raw = (rng.choice(WHOLE) % (1 << 8 * size)).to_bytes(size, rng.choice(("little", "big")))
    return data[:at] + raw + data[at + size :]


def _swap(data, rng):
    (a, b), (c, d) = sorted((_slice(data, rng), _slice(data, rng)))
    return data if b > c else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


_BYTES: tuple[Mutation, ...] = (
    *(_flip, _flip, _truncate, _delete, _repeat, _insert, _blank, _number, _number, _swap),
)


def of_json(data, rng):
    """A value replaced, removed, renamed or doubled; now and then damage to the text."""
    if rng.random() < 0.25:
        return of_bytes(data, rng)
    return written(changed(json.loads(data), rng))


def changed(value, rng):
    """JSON data with one to three places changed."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 2, 3))):
        holders = list(_holders(value))
        if not holders:
            return copy.deepcopy(rng.choice(VALUES))
        holder = rng.choice(holders)
        key = rng.choice(list(holder)) if isinstance(holder, dict) else rng.randrange(len(holder))
        what = rng.random()
        if what < 0.7:
            holder[key] = copy.deepcopy(rng.choice(VALUES))
        elif what < 0.85:
            del holder[key]
        elif isinstance(holder, dict):
            name = rng.choice((key + "x", key[:-1], TWICE + key, "", "é"))
            holder[name] = holder[key] if name.startswith(TWICE) else holder.pop(key)
        else:
            holder.insert(key, holder[key])
    return value


def _holders(value):
    if isinstance(value, dict | list):
        if value:
            yield value
        for child in value.values() if isinstance(value, dict) else value:
            yield from _holders(child)


def written(value):
    """JSON text, with what json.dumps cannot write: depth, repeated keys, numbers of any length."""
    text = json.dumps(value, default=str)
    text = text.replace(json.dumps(DEEP), "[" * 100_000 + "]" * 100_000)
    text = text.replace(json.dumps(ENDLESS), "9" * 5000)
    return text.replace(json.dumps(TWICE)[1:-1], "").encode()


def of_text(data, rng):
    """A word of a text replaced by another of its words, a hostile one, or an extreme number."""
    if rng.random() < 0.25:
        return of_bytes(data, rng)
    text = data.decode("latin-1")
    for _ in range(rng.choice((1, 1, 2))):
        words = list(re.finditer(r"[^\s,:\[\]{}]+", text))
        if not words:
            return data
        word = rng.choice(words)
        other = rng.choice(
            (rng.choice(words).group(), rng.choice(YAML_TEXTS), str(rng.choice(WHOLE)), "nan", "1e999")
        )
        text = text[: word.start()] + other + text[word.end() :]
    return text.encode("utf-8" if rng.random() < 0.5 else "latin-1", "replace")


def of_header(data, rng):
    """Mutate a PLY: a word of its text header, or bytes anywhere."""
    end = data.find(b"end_header")
    if end < 0 or rng.random() < 0.4:
        return of_bytes(data, rng)
    return of_text(data[:end], rng) + data[end:]
