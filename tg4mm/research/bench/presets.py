"""The complete benchmark as repeatable commands for datasets and methods."""

import json
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.values import require
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.methods.known import DEFAULT, checked_names, methods_of, parse_external
from tg4mm.research.generator import run_child

Printer = Callable[[str], None]
SCENES = ("mic", "chair", "lego", "hotdog", "drums", "ficus", "materials", "ship")
_SMOKE = ("--preset", "smoke", "--size", "48", "--timesteps", "8", "--alphas", "5,20")
_SMOKE_SETTINGS = (
    "space.iterations=300", "space.max_gaussians=2000", "tracking.iterations=100", "paper.warm_up=150",
    "paper.iterations=300", "paper.motion_iterations=20", "paper.channels=4", "paper.resolution=32",
)  # fmt: skip

# Of the splits: sized for a bound of the first mode of a tenth (docs/protocol.md).
_SPLIT = ("--noise", "picture", "--amplitude-px", "0.5", "--alphas", "5,10,20")
_DEV = (  # scene, Hz, timesteps at 30 Hz, seed; 4.3 Hz lies between the bins
    ("mic", 5, 6, 0), ("chair", 5, 6, 1), ("lego", 5, 6, 0), ("hotdog", 5, 6, 2), ("ficus", 5, 6, 1),
    ("materials", 5, 6, 2), ("ship", 5, 6, 0), ("drums", 5, 6, 1), ("mic", 4.3, 12, 2), ("chair", 3, 10, 0),
)  # fmt: skip
_METHODS = ("modal", "sc-gs", "phase-2d")
_COST, _MORE = "--views 12 --samples 32", "--views 30 --samples 64"  # drums show their motion least
_DEV_SCENES = tuple(
    f"{scene} --frequency {hz} --timesteps {n} --seed {seed} {_MORE if scene == 'drums' else _COST} --test-views 1"
    for scene, hz, n, seed in _DEV
)
_TEST_SCENES = tuple(  # half a second with a second mode at 7.3 Hz; 4.6 and 7.3 Hz lie between the bins
    f"{scene} --motion second --timesteps 15 --seed {100 + i % 3} {_MORE if scene == 'drums' else _COST}"
    f" --test-views 2 --cameras rig{' --frequency 4.6' if i in (0, 5) else ''}"
    for i, scene in enumerate(SCENES)
)
_TEXT, _TEXTS, _NUMBERS = "a text", "a list of texts", "a list of whole numbers"


@dataclass(frozen=True)
class BenchPreset:
    """The datasets and methods of a benchmark."""

    scenes: tuple[str, ...]  # each a built-in scene, or --blend FILE --motion FILE, with options
    options: tuple[str, ...]  # of `tg4mm generate`, for all of them
    methods: tuple[str, ...] = DEFAULT
    settings: tuple[str, ...] = ()  # KEY=VALUE, as `--set`
    seeds: tuple[int, ...] = ()  # of the generator, every scene with each; (): its default


PRESETS = {
    "smoke": BenchPreset(("mic",), _SMOKE, settings=_SMOKE_SETTINGS),
    "small": BenchPreset(SCENES, ("--samples", "32")),
    "dev": BenchPreset(_DEV_SCENES, _SPLIT, _METHODS),
    "test": BenchPreset(_TEST_SCENES, _SPLIT, _METHODS),
    "paper": BenchPreset(SCENES, ("--preset", "paper"), methods=(*DEFAULT, "paper")),
    "mic-512": BenchPreset(("mic",), ("--preset", "paper"), methods=("modal", "tracking", "phase-2d")),
}


@dataclass(frozen=True)
class PresetStep:
    """A command."""

    name: str  # the path of its mark
    command: tuple[str, ...]  # arguments, the first is the program
    needs: tuple[str, ...] = ()  # names of steps


@dataclass(frozen=True)
class Choices:
    """A user's options of `tg4mm bench scenes` beyond a preset; empty: not given."""

    external: tuple[str, ...] = ()  # NAME=DIR
    alphas: str = ""  # also of the rendered ground truth
    device: str = ""
    lpips_weights: tuple[str, ...] = ()
    md_vqa: str = ""
    fast_vqa: str = ""
    vqa_python: str = ""

    def check(self) -> None:
        """Raise BenchError for an outside method that every job would refuse."""
        methods_of((), {}, parse_external(list(self.external)))

    def options(self, *names: str) -> list[str]:
        """Return command-line arguments for the given options (default: all)."""
        found = []
        for name in names or [f.name for f in fields(self)]:
            value = getattr(self, name)
            for one in (value,) if isinstance(value, str) else value:
                found += [f"--{name.replace('_', '-')}", one] if one else []
        return found


@dataclass(frozen=True)
class _Data:
    label: str  # in the tables
    step: str  # its name
    given: str  # the folder as DATASET or NAME=DATASET
    options: tuple[str, ...]  # of `tg4mm generate`, --out apart
    parent: str  # --out


def steps_of(
    name: str | BenchPreset, out: str, python: str = sys.executable, choices: Choices = Choices()
) -> list[PresetStep]:
    """Return the steps of a preset in the folder `out`, in order: datasets, jobs, page.

    Raises BenchError for an unknown preset and two datasets of one folder.
    """
    if isinstance(name, str) and name not in PRESETS:
        raise BenchError(f"--preset {name!r}, expected {', '.join(PRESETS)}")
    chosen = PRESETS[name] if isinstance(name, str) else name
    program = (python, "-m", "tg4mm")
    datasets = _datasets(chosen, out)
    rendered = choices.options("alphas")
    found = [
        PresetStep(
            data.step,
            (*program, "generate", data.options[0], "--out", data.parent, *data.options[1:], *rendered),
        )
        for data in datasets
    ]
    options = ["--out", f"{out}/bench", "--methods", ",".join(chosen.methods)]
    options += [part for text in chosen.settings for part in ("--set", text)]
    options += choices.options()
    outside = [text.partition("=")[0] for text in choices.external]
    for data in datasets:
        for method in (*chosen.methods, *outside):
            command = (*program, "bench", "job", data.given, method, *options)
            found.append(PresetStep(f"job/{data.label}/{method}", command, (data.step,)))
    given = (data.given for data in datasets)
    page = (*program, "bench", "scenes", *given, *options, "--same-time", "never", "--collect")
    return [*found, PresetStep("page", page, tuple(step.name for step in found))]


def _datasets(chosen: BenchPreset, out: str) -> list[_Data]:
    found: dict[str, _Data] = {}
    for seed in chosen.seeds or (None,):
        for scene in chosen.scenes:
            options = (*shlex.split(scene), *chosen.options)
            parent = f"{out}/data"
            if seed is not None:
                options, parent = (*options, "--seed", str(seed)), f"{parent}/seed{seed}"
            folder = _folder(options)
            label = folder if seed is None else f"{folder}_s{seed}"
            if label in found:
                raise BenchError(
                    f"scene {scene!r} and another scene have the same folder {folder}: rename one with --name"
                )
            given = f"{parent}/{folder}" if seed is None else f"{label}={parent}/{folder}"
            step = f"data/{folder}" if seed is None else f"data/seed{seed}/{folder}"
            found[label] = _Data(label, step, given, options, parent)
    return list(found.values())


def _folder(options: Sequence[str]) -> str:
    """Return the name of the dataset's folder, which the generator chooses."""
    from dataset_gen.options import parser, request_from

    (settings,) = request_from(parser().parse_args([*options, "--out", "data"])).sets
    return settings.folder


def run_preset(name: str, out: Path, choices: Choices = Choices(), say: Printer = print) -> int:
    """Run the steps in order; failures are printed, and independent steps continue. Returns the number of failures."""
    steps, failed = steps_of(name, str(out), choices=choices), set[str]()
    for i, step in enumerate(steps, 1):
        missing = [n for n in step.needs if n in failed]
        if missing and step.name != "page":
            say(f"[{i}/{len(steps)}] {step.name}: left out, since {missing[0]} failed")
            failed.add(step.name)
            continue
        say(f"[{i}/{len(steps)}] {step.name}")
        status = run_child(step.command)
        if status != 0:
            failed.add(step.name)
            rest = "; continuing with the rest" if i < len(steps) else ""
            say(f"    {step.name} ended with status {status}{rest}")
    return len(failed)


def _given(config: Mapping[str, Any], kinds: Mapping[str, str]) -> dict[str, Any]:
    """Return the values in a configuration, lists as tuples. Raises BenchError for one of another kind."""
    found: dict[str, Any] = {}
    for key, kind in kinds.items():
        value = config.get(key)
        one = int if kind == _NUMBERS else str
        if kind == _TEXT and type(value) in (str, int, float):  # `alphas: 20` is a number in YAML
            found[key] = str(value)
        elif kind != _TEXT and isinstance(value, list) and all(type(each) is one for each in value):
            found[key] = tuple(value)
        elif value is not None:
            raise BenchError(f"configuration: {key} is {value!r}, expected {kind}")
    return found


def choices_from(config: Mapping[str, Any]) -> Choices:
    """Return the choices of a configuration file. Raises BenchError for a value of another type, and for an option."""
    for key in (f.name for f in fields(Choices)):
        if str(config.get(key)).startswith("-"):
            raise BenchError(f"configuration: {key} is {config[key]!r}, expected no option")
    kinds = {f.name: _TEXTS if isinstance(f.default, tuple) else _TEXT for f in fields(Choices)}
    return Choices(**_given(config, kinds))


def preset_from(config: Mapping[str, Any]) -> str | BenchPreset:
    """Return a configuration's preset with its changes. Raises BenchError for another type of value."""
    name = config.get("preset")
    if not isinstance(name, str) or name not in PRESETS:
        raise BenchError(f"configuration: preset is {name!r}, expected {', '.join(PRESETS)}")
    kinds = {"scenes": _TEXTS, "methods": _TEXTS, "settings": _TEXTS, "seeds": _NUMBERS, "options": _TEXT}
    changes = _given(config, kinds)
    if "options" in changes:
        changes["options"] = tuple(shlex.split(changes["options"]))
    if changes.get("scenes") == ():
        raise BenchError("configuration: scenes is [], expected one or more")
    checked_names(changes.get("methods", DEFAULT))
    if "methods" in changes:
        changes.setdefault("settings", ())  # the preset's are for its methods
    return replace(PRESETS[name], **changes) if changes else name


def main() -> int:
    """Read {preset, out, python, fields of `Choices` and `BenchPreset`} as JSON; print {step: {command, needs}}."""
    from tg4mm.core.untrusted import parse_json

    try:
        config: Any = parse_json(sys.stdin.read())
        require("configuration", config, dict, BenchError)
        config = {"python": sys.executable, **config}
        for key in ("preset", "out", "python"):
            value = config.get(key)
            if not (isinstance(value, str) and value and value.isprintable() and value[0] != "-"):
                raise BenchError(
                    f"configuration: {key} is {value!r}, expected non-empty printable text that does not begin with -"
                )
        choices = choices_from(config)
        choices.check()
        steps = steps_of(preset_from(config), config["out"].rstrip("/"), config["python"], choices)
    except (Tg4mmError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    found = {s.name: {"command": shlex.join(s.command), "needs": list(s.needs)} for s in steps}
    json.dump(found, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
