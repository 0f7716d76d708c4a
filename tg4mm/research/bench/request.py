"""What a user gives for several presets at once, sorted by preset."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from tg4mm.core.errors import Tg4mmError
from tg4mm.run.preset import preset_named
from tg4mm.run.train import parse_settings

# With a `paper` preset the base Gaussians' iterations are paper.warm_up, so this one is for modal alone.
_OF_MODAL = {"space.iterations"}


def settings_by_preset(given: Mapping[str, str], presets: Sequence[str]) -> dict[str, dict[str, str]]:
    """For each preset those of the settings that it has.

    Raises Tg4mmError for a setting that none of the presets has, and for a value that does not fit.
    """
    known = {p: setting_names(p) for p in presets}
    for name in given:
        if not any(name in names for names in known.values()):
            listed = ", ".join(sorted(set().union(*known.values()))) or "none"
            raise Tg4mmError(f"--set {name}: no method here has that setting; there are: {listed}")
    chosen = {p: {k: v for k, v in given.items() if k in known[p]} for p in presets}
    for preset, settings in chosen.items():
        check_settings(settings, preset)
    return chosen


def setting_names(preset: str) -> set[str]:
    """What `--set` can name with this preset."""
    names = {f"{s}.{f.name}" for s, c in preset_named(preset).defaults.items() for f in dataclasses.fields(c)}
    return names if preset == "modal" else names - _OF_MODAL


def check_settings(settings: Mapping[str, str], preset: str) -> None:
    """Raise Tg4mmError for a setting that `tg4mm train` would refuse, before anything is written."""
    preset_named(preset).check(parse_settings(settings, preset))
