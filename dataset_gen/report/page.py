"""The report of a dataset: `report/index.html` and the contact sheet as a picture of its own."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.capture import Capture, dataset_tree
from tg4mm.capture.truth_file import TRUTH_FILE, Truth, load_truth
from tg4mm.core import __version__
from tg4mm.core.digits import number, size_text
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.pages.page import Block, Figure, Page, Section, Stat, Table, Text, picture, render_page
from tg4mm.core.pictures.decode import decode
from tg4mm.core.untrusted import read_formed

from ..cameras.camera import project
from ..errors import GenerateError
from ..plan import magnified_folder
from ..tree import TIMING, whole
from ..vibration import reach

MOVING = 0.01  # of the set's largest displacement: a vertex displaced by more counts as moving
_MOST_VERTICES = 20_000  # projected
_MOST_TIMES = 30  # timesteps projected
_EDGE = 168  # of a picture of the contact sheet, pixels
_ACROSS = 6  # training cameras in a row
_SMALL_PX = 0.01  # motion below this is far under the noise of a single picture
_GAP, _LABEL = 6, 20  # between them and under them, pixels
_MOST_TEST, _MOST_TRAIN, _MOST_PARTS = 3, 18, 6


@dataclass(frozen=True)
class ModeSummary:
    """One mode of truth/motion.npz."""

    name: str
    frequency_hz: float  # 0: a drift
    amplitude: float  # largest displacement of any vertex, scene units
    magnified: bool  # whether α applies to it
    parts: tuple[tuple[str, float], ...]  # objects that move and their largest displacement, largest first


@dataclass(frozen=True)
class ViewMotion:
    """Projected motion in one camera: of each moving vertex in the picture the largest over time, pixels."""

    name: str
    maximum: float
    p95: float
    median: float


@dataclass(frozen=True)
class Findings:
    """All that was read and measured for a report."""

    root: Path
    train: Capture | None
    test: Capture | None
    alphas: tuple[float, ...]
    strength: (
        np.ndarray
    )  # [T] largest displacement of any vertex, scene units; empty without truth/motion.npz
    modes: tuple[ModeSummary, ...]
    views: tuple[ViewMotion, ...]  # test cameras, or training cameras without any

    @property
    def any(self) -> Capture:
        """The training views, or the test views where there are none."""
        capture = self.train or self.test
        assert capture is not None
        return capture

    @property
    def amplitude(self) -> float:
        """Largest displacement over time, scene units; as described where the truth is absent."""
        described = self.any.scene.get("amplitude")
        if self.strength.size:
            return float(self.strength.max())
        return float(described) if isinstance(described, int | float) else 0.0

    @property
    def strongest(self) -> int:
        """The timestep farthest from rest, the first of several; 0 where that is not known."""
        return int(np.argmax((self.strength / (self.amplitude or 1)).round(4))) if self.strength.size else 0


def find(root: Path) -> Findings:
    """Reads and measures the dataset. Raises GenerateError with file and reason if it is none."""
    try:
        train, test = _load(root, "train"), _load(root, "test")
        capture = train or test
        if capture is None:
            raise GenerateError(f"{root}: holds neither training nor test views")
        truth = None
        if (root / TRUTH_FILE).is_file():
            truth = load_truth(root, capture.fps, capture.n_timesteps)
        alphas = tuple(a for a in capture.scene.get("alphas") or () if isinstance(a, int | float))
        strength = _strength(truth, capture.n_timesteps) if truth else np.zeros(0)
        modes = tuple(_modes(truth, capture)) if truth else ()
        views = tuple(_motions(truth, test or capture, float(strength.max()))) if truth else ()
    except (CaptureError, OSError) as error:
        raise GenerateError(str(error)) from error
    return Findings(root, train, test, alphas, strength, modes, views)


def read_picture(path: Path) -> np.ndarray:
    """A picture over white, [H, W, 3] float32 in 0..1, display-referred. Raises GenerateError."""
    try:
        pixels = decode(path)
    except (CaptureError, OSError) as error:
        raise GenerateError(f"{path}: cannot be read: {error}") from error
    values = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return values[..., :3] * values[..., 3:] + 1 - values[..., 3:]


def magnified(root: Path, picture: Path, alpha: float) -> Path:
    """Return the path of a test picture's ground truth at α; the picture itself for α = 0."""
    return root / magnified_folder(alpha) / picture.relative_to(root) if alpha else picture


def _load(root: Path, split: str) -> Capture | None:
    if not root.is_dir():
        raise GenerateError(f"{root}: is not a folder")
    try:
        return dataset_tree.load(root, split, 0)
    except MissingSplitError:
        return None


def _gains(truth: Truth) -> np.ndarray:
    """Return [K, T] complex."""
    if truth.gains is not None:
        return truth.gains
    return np.exp(2j * np.pi * np.outer(truth.freqs_hz, np.arange(truth.n_timesteps)) / truth.fps)


def _displaced(truth: Truth, timestep: int) -> list[np.ndarray]:
    """Displacement [V, 3] of every object, scene units."""
    gains = _gains(truth)[:, timestep]
    return [np.tensordot(gains, body.modes, axes=1).real for body in truth.objects]


def _strength(truth: Truth, n_timesteps: int) -> np.ndarray:
    return np.array(
        [
            max(np.linalg.norm(d, axis=1).max(initial=0.0) for d in _displaced(truth, t))
            for t in range(n_timesteps)
        ]
    )


def _modes(truth: Truth, capture: Capture) -> Iterable[ModeSummary]:
    described = capture.scene.get("modes") or []
    for k, frequency in enumerate(truth.freqs_hz):
        gain = float(np.abs(_gains(truth)[k]).max(initial=0.0))
        peaks = [(body.name, gain * float(reach(body.modes[k]).max(initial=0.0))) for body in truth.objects]
        peaks.sort(key=lambda named: -named[1])
        top = peaks[0][1]
        own = described[k] if k < len(described) and isinstance(described[k], dict) else {}
        name = str(own.get("name") or own.get("kind") or f"mode {k + 1}")
        alpha = truth.magnified is None or bool(truth.magnified[k])
        yield ModeSummary(
            name, float(frequency), top, alpha, tuple(p for p in peaks if top and p[1] > 1e-6 * top)
        )


def _motions(truth: Truth, capture: Capture, amplitude: float) -> Iterable[ViewMotion]:
    """Motion of every camera, by vertices inside its pictures, hidden ones too."""
    stride = max(1, sum(len(body.rest) for body in truth.objects) // _MOST_VERTICES)
    rest = np.concatenate([body.rest[::stride] for body in truth.objects])
    times = _evenly(capture.n_timesteps, _MOST_TIMES)
    displaced = {t: np.concatenate([d[::stride] for d in _displaced(truth, t)]) for t in times}
    largest = np.max([np.linalg.norm(d, axis=1) for d in displaced.values()], axis=0)
    moving = largest > MOVING * amplitude
    names: dict[str, dict[int, int]] = {}
    for i, path in enumerate(capture.paths):
        names.setdefault(path.stem, {})[int(capture.timesteps[i])] = i
    for name, rows in names.items():
        peak = np.full(int(moving.sum()), np.nan)
        for t in times:
            if t in rows:
                step = _step(rest[moving], displaced[t][moving], capture, rows[t])
                peak = np.fmax(peak, step)
        seen = peak[~np.isnan(peak)]
        p95, median = np.percentile(seen, [95, 50]) if seen.size else (0.0, 0.0)
        yield ViewMotion(name, float(seen.max(initial=0.0)), float(p95), float(median))


def _step(rest: np.ndarray, displaced: np.ndarray, capture: Capture, row: int) -> np.ndarray:
    """Pixels [V] between where points are and where they are at rest, NaN outside the picture."""
    pose = np.linalg.inv(capture.viewmats[row]) @ np.diag([1.0, -1.0, -1.0, 1.0])
    K = capture.Ks[row]
    intrinsics = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    still, depth = project(rest, pose, intrinsics)
    moved, _ = project(rest + displaced, pose, intrinsics)
    with np.errstate(invalid="ignore"):
        inside = (depth > 1e-9) & ((still >= 0) & (still < (capture.width, capture.height))).all(-1)
    return np.where(inside, np.linalg.norm(moved - still, axis=-1), np.nan)


def _evenly(count: int, most: int) -> list[int]:
    return sorted({i * count // min(count, most) for i in range(min(count, most))})


def write(root: Path) -> Path:
    """See `dataset_gen.report.write_report`."""
    findings = find(root)
    folder = root / "report"
    folder.mkdir(exist_ok=True)
    sheet = contact_sheet(findings)
    page = render_page(_page(findings, sheet))
    _save(folder / "contact_sheet.png", lambda path: sheet.save(path, "PNG"))
    _save(folder / "index.html", lambda path: path.write_text(page, encoding="utf-8"))
    return folder / "index.html"


def _save(path: Path, make: Callable[[Path], object]) -> None:
    with whole(path) as temporary:
        make(temporary)


def _page(f: Findings, sheet: Image.Image) -> Page:
    scene = str(f.any.scene.get("scene", f.root.name))
    return Page(
        title=f"{scene[:1].upper()}{scene[1:]}: a set with exact motion",
        kicker="vibration dataset, report of its contents",
        summary=f"{_cameras(f)}, {f.any.width} × {f.any.height} pixels, {_length(f, f.amplitude)} of motion at most.",
        stats=_stats(f),
        lead=[Text(words, style="note") for words in warnings(f)],
        sections=[
            Section("The pictures", [_sheet_figure(sheet)]),
            Section("How it moves", list(_motion(f))),
        ],
        footer=f"tg4mm {__version__}. {f.root.name}. Written from the files of the set alone.",
    )


def warnings(f: Findings) -> list[str]:
    """Return warnings for a user of the set: missing parts, and properties that make it hard to use."""
    said = []
    if f.test is None:
        said.append("There are no test views, so there is nothing to score.")
    if not f.alphas:
        said.append("Ground truth of magnified motion is absent.")
    if not f.strength.size:
        said.append("truth/motion.npz is absent: the motion is known from scene.json only.")
    if f.any.unit_scale_m is None:
        said.append("Scale unknown: lengths are in scene units.")
    for mode in f.modes:
        if _between_bins(f, mode):
            said.append(
                f"The frequency of {mode.name}, {number(mode.frequency_hz, 4)} Hz, lies between the bins of the set's "
                f"{f.any.n_timesteps} timesteps: its spectrum spreads over the neighbours."
            )
    largest = max((view.maximum for view in f.views), default=None)
    if largest is not None and largest < _SMALL_PX:
        said.append(f"The motion is small: {number(largest)} pixels at most in any picture.")
    return said


def _stats(f: Findings) -> list[Stat]:
    capture = f.any
    seconds = number(capture.n_timesteps / capture.fps)
    value, unit = size_text(_bytes_on_disk(f.root)).split(" ")
    stats = [
        Stat("Timesteps", str(capture.n_timesteps), "", f"{number(capture.fps)} Hz, {seconds} s"),
        Stat("Largest displacement", number(f.amplitude), "units", "at any timestep, α = 0"),
        Stat("On disk", value, unit, "equal pictures counted once"),
    ]
    if f.views:
        view = max(f.views, key=lambda v: v.maximum)
        stats.insert(2, Stat("Largest motion in a picture", number(view.maximum), "px", f"in {view.name}"))
    try:
        timing = read_formed(f.root / "report/timing.json", TIMING)
        stats.append(
            Stat("Rendered in", number(timing["seconds"]), "s", f"{timing['pictures']:,} distinct pictures")
        )
    except (OSError, ValueError):
        pass  # a set that was copied without it, or made elsewhere
    return stats


def _bytes_on_disk(root: Path) -> int:
    files = (path.stat() for path in root.rglob("*") if path.is_file() and "report" not in path.parts)
    return sum({(stat.st_dev, stat.st_ino): stat.st_size for stat in files}.values())


def _sheet_figure(sheet: Image.Image) -> Figure:
    caption = (
        "Contact sheet (report/contact_sheet.png). Test cameras at timesteps 0 and farthest from rest, then magnified "
        "at each α; training cameras below. A displacement grows to (1 + α) times its size."
    )
    return Figure([picture(np.asarray(sheet), alt="contact sheet")], caption)


def _motion(f: Findings) -> Iterable[Block]:
    rows = [
        [
            mode.name,
            f"{number(mode.frequency_hz, 4)} Hz" if mode.frequency_hz else "drift",
            _length(f, mode.amplitude),
            "yes" if mode.magnified else "no",
            _parts(mode),
        ]
        for mode in f.modes
    ]
    if rows:
        caption = (
            "From truth/motion.npz: largest displacement of any vertex, and the parts with their share of it."
        )
        yield Table(["mode", "frequency", "amplitude", "magnified", "moving parts"], rows, caption, left=5)
    if f.views:
        caption = (
            "Motion in the picture at α = 0, pixels: of each vertex that moves the largest over time; hidden vertices "
            "inside the picture count, too. Multiply by (1 + α) for the magnified ground truth."
        )
        rows = [[v.name, *(number(x, 3, trim=False) for x in (v.maximum, v.p95, v.median))] for v in f.views]
        yield Table(["camera", "max", "95 %", "median"], rows, caption)


def _parts(mode: ModeSummary) -> str:
    shown = [f"{name} ({100 * size / mode.amplitude:.0f} %)" for name, size in mode.parts[:_MOST_PARTS]]
    more = len(mode.parts) - len(shown)
    return (", ".join(shown) or "nothing") + (f" and {more} more" if more else "")


def _between_bins(f: Findings, mode: ModeSummary) -> bool:
    cycles = mode.frequency_hz * f.any.n_timesteps / f.any.fps
    return abs(cycles - round(cycles)) > 1e-6


def _cameras(f: Findings) -> str:
    counts = [
        (len({p.stem for p in c.paths}) if c else 0, split)
        for c, split in ((f.train, "training"), (f.test, "test"))
    ]
    return " and ".join(f"{n} {split} camera{'' if n == 1 else 's'}" for n, split in counts)


def _length(f: Findings, value: float) -> str:
    text, scale = f"{number(value)} units", f.any.unit_scale_m
    if scale is None:
        return text
    metres = value * scale
    unit, factor = next(((u, k) for u, k in (("m", 1.0), ("mm", 1e-3)) if abs(metres) >= k), ("µm", 1e-6))
    return f"{text} ({number(metres / factor)} {unit})"


def contact_sheet(f: Findings) -> Image.Image:
    """Test cameras as captured and magnified, a row each; then training cameras at timestep 0. On white."""
    rows: list[tuple[str, list[tuple[Path, str]]]] = []
    if f.test is not None:
        views = list(zip(f.test.paths, f.test.timesteps.tolist(), strict=True))
        for name in list(dict.fromkeys(path.stem for path, _ in views))[:_MOST_TEST]:
            own = {t: path for path, t in views if path.stem == name}
            cells = [(own[t], f"t = {t}") for t in sorted({0, f.strongest}) if t in own]
            if f.strongest in own:
                path = own[f.strongest]
                cells += [(magnified(f.root, path, a), f"alpha = {a:g}, t = {f.strongest}") for a in f.alphas]
            rows.append((f"test {name}: as captured, then the ground truth magnified", cells))
    if f.train is not None:
        first = [path for path, t in zip(f.train.paths, f.train.timesteps, strict=True) if t == 0]
        shown = [(path, path.stem) for path in first[:_MOST_TRAIN]]
        heading = f"training cameras at timestep 0 ({len(shown)} of {len(first)})"
        for i in range(0, len(shown), _ACROSS):
            rows.append(("" if i else heading, shown[i : i + _ACROSS]))
    return _drawn(rows, f.any.width / f.any.height)


def _drawn(rows: list[tuple[str, list[tuple[Path, str]]]], aspect: float) -> Image.Image:
    width, height = (_EDGE, round(_EDGE / aspect)) if aspect >= 1 else (round(_EDGE * aspect), _EDGE)
    font, bold = (ImageFont.load_default(size) for size in (12, 14))
    across = max(len(cells) for _, cells in rows)
    total = sum(height + _LABEL + _GAP + (26 if heading else 0) for heading, _ in rows) + _GAP
    made = Image.new("RGB", (across * (width + _GAP) + _GAP, total), "white")
    draw = ImageDraw.Draw(made)
    y = _GAP
    for heading, cells in rows:
        if heading:
            draw.text((_GAP, y + 4), heading, "black", bold)
            y += 26
        for i, (path, label) in enumerate(cells):
            x = _GAP + i * (width + _GAP)
            if path.is_file():
                pixels = Image.fromarray((read_picture(path) * 255 + 0.5).astype(np.uint8))
                made.paste(pixels.resize((width, height), Image.Resampling.LANCZOS), (x, y))
            else:
                draw.rectangle((x, y, x + width - 1, y + height - 1), outline="gray")
                draw.text((x + 8, y + height // 2 - 8), "absent", "gray", font)
            draw.text((x + 1, y + height + 2), label, "gray", font)
        y += height + _LABEL + _GAP
    return made
