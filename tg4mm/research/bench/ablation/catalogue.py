"""The ablations, declared: what varies, with which settings or filters or data, and which columns tell about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tg4mm.core.choices import FILTERS
from tg4mm.core.filters import TemporalFilter
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.ablation.sets import KINDS
from tg4mm.research.bench.request import Scoring
from tg4mm.research.bench.sets import BenchSet
from tg4mm.run.preset import preset_named

_NOISE = 5.0  # of 255: a sensor's, where the ablation is of something else


@dataclass(frozen=True)
class Row:
    """One variant."""

    label: str  # "": what is scaled, and to what
    settings: Mapping[str, str] = field(default_factory=dict)  # as `--set`
    scalings: Mapping[str, float] = field(
        default_factory=dict
    )  # a setting as a multiple of its value without this row
    scorings: tuple[Scoring, ...] = ()  # (): those of the preset
    views: int = 0  # training cameras; 0: all
    timesteps: int = 0  # the first so many; 0: all
    noise: float = 0.0  # standard deviation added to the training pictures, of 255; 0: none
    amplitude_px: float = 0.0  # 0: the dataset's own
    kind: str = ""  # how the scene is filmed, one of `again.KINDS`; "": as the dataset
    tick: str = ""  # in a picture; "": the label
    curve: str = ""  # in a picture over the rows: which curve it is on; "": on all
    apart: bool = False  # in such a picture: of another kind than the other rows, with no line to them

    @property
    def changed_data(self) -> list[Any]:
        """What of the data is not the dataset's own."""
        return [
            self.views,
            self.timesteps,
            self.noise,
            self.amplitude_px,
            *([self.kind] if self.kind else []),
        ]

    @property
    def is_rendered(self) -> bool:
        """Whether its data are rendered anew."""
        return bool(self.amplitude_px or self.kind)


@dataclass(frozen=True)
class Ablation:
    """One ablation. Columns beyond SSIM and its gap are keys of `means.scalars`."""

    title: str
    source: str  # where it stands in the paper, or why it is here
    presets: tuple[str, ...]  # that it can vary; the first is the default
    rows: tuple[Row, ...]
    columns: tuple[str, ...] = ("displacement_error", "static_leak", "amplitude_ratio", "total_s")
    picture: str = "ssim"  # SSIM over α; or a column, drawn over the rows
    x_label: str = ""  # of a picture over the rows
    slices: bool = False  # space-time slices too
    remark: str = ""


def _scaled(setting: str, *factors: float) -> tuple[Row, ...]:
    return tuple(
        Row("", scalings={setting: f}, tick=f"× {f:g}", curve="" if f == 1 else setting) for f in factors
    )


def _filters(method: str) -> tuple[Row, ...]:
    return tuple(Row(f"{method}, {kind}", scorings=(Scoring(method, method, kind),)) for kind in FILTERS)


ABLATIONS: dict[str, Ablation] = {
    "initialisation": Ablation(
        "Initialisation",
        "[TG4MM] Table IV, whose other start (VGGT) needs learned weights that are not part of this program",
        ("modal", "paper-tuned", "paper"),
        (
            Row("hull", {"space.init": "hull"}),
            Row("points3d.ply", {"space.init": "points"}),
            Row("SfM", {"space.init": "sfm"}),
            Row("random", {"space.init": "random"}),
        ),
        ("init", "psnr_rest", "n_gaussians", "displacement_error", "static_leak", "space_s"),
    ),
    "decoder": Ablation(
        "Decoder",
        "[TG4MM] Table VI: heads alone, or an MLP of 8 layers × 256 before them; one layer is what its §IV.B says",
        ("paper-tuned", "paper"),
        (
            Row("decoder only", {"paper.mlp_layers": "0"}),
            Row("MLP 1 × 256 + decoder", {"paper.mlp_layers": "1", "paper.mlp_width": "256"}),
            Row("MLP 8 × 256 + decoder", {"paper.mlp_layers": "8", "paper.mlp_width": "256"}),
        ),
        ("psnr_rest", "displacement_error", "static_leak", "amplitude_ratio", "mib_on_disk", "total_s"),
    ),
    "residual": Ablation(
        "Residual triplanes",
        "[TG4MM] Fig. 8: a timestep's planes are added to the space planes (Eq. 6), or take their place",
        ("paper-tuned", "paper"),
        (
            Row("with residual", {"paper.residual": "true"}),
            Row("without residual", {"paper.residual": "false"}),
        ),
        slices=True,
        remark="In the paper the variant without comes out static; SSIM beside “nothing moves” shows how far it moves.",
    ),
    "iterations": Ablation(
        "Iterations of both stages",
        "[TG4MM] Fig. 10: one phase's iterations vary while the other's stay",
        ("paper-tuned", "paper", "modal"),
        (),  # by preset, see `rows_of`
        ("psnr_rest", "displacement_error", "static_leak", "space_s", "motion_s"),
        picture="displacement_error",
        x_label="iterations, as multiples of the preset's",
    ),
    "filter-phase": Ablation(
        "Phase of the temporal filter",
        "A FIR of even length has no centre tap, so its output is half a sample early",
        ("paper-tuned", "paper", "modal"),
        (),
        ("filter_phase_deg", "filter_error"),
        slices=True,
        remark="One training, scored with each filter. Phase and error are the filter's own at the motion's frequency, "
        "of its response H there: arg H and |H − 1|.",
    ),
    "difference": Ablation(
        "Difference loss",
        "Compare changes from timestep 0 with changes, which takes static errors out of the fit",
        ("paper-tuned", "paper"),
        (
            Row("pictures (Eq. 16)", {"paper.difference": "false"}),
            Row("differences", {"paper.difference": "true"}),
        ),
        remark="Varied in phase 2 of the paper's method. In `modal` it cannot be switched off honestly: its functions "
        "of time are orthogonal to the constant, so static errors drop out of the normal equations exactly.",
    ),
    "smoothness": Ablation(
        "Smoothness weight",
        "The prior, which makes neighbours move alike",
        ("modal",),
        (
            Row("found from the images", {"motion.smoothness_weight": "0"}, tick="found", apart=True),
            # 0 stands for "found"; this is as good as none: the smallest weight that was ever of use is 5.
            *(
                Row(f"weight {w}", {"motion.smoothness_weight": w}, tick=w)
                for w in ("1e-6", "5", "50", "500", "5000")
            ),
        ),
        ("displacement_error", "static_leak", "amplitude_ratio", "direction_error_deg", "motion_s"),
        picture="displacement_error",
        x_label="smoothness weight",
    ),
    "views": Ablation(
        "Number of training cameras",
        "How few cameras are enough",
        ("modal", "paper-tuned", "paper"),
        tuple(Row(f"{n} views", views=n, tick=str(n)) for n in (3, 5, 10, 15, 20))
        + (Row("all views", tick="all"),),
        ("displacement_error", "static_leak", "amplitude_ratio", "direction_error_deg", "total_s"),
        picture="displacement_error",
        x_label="training cameras",
        remark="Cameras are left out evenly along the path; the test cameras stay. Files are hard links where the file "
        "system has them.",
    ),
    "timesteps": Ablation(
        "Number of timesteps",
        "How short a record is enough",
        ("modal", "paper-tuned", "paper"),
        tuple(Row(f"{n} timesteps", timesteps=n, noise=_NOISE, tick=str(n)) for n in (6, 12, 18, 24))
        + (Row("all timesteps", noise=_NOISE, tick="all"),),
        ("displacement_error", "displacement_error_observed", "static_leak", "amplitude_ratio", "total_s"),
        picture="displacement_error",
        x_label="timesteps",
        remark="The first timesteps of the record, with their ground truth; to the training pictures noise of "
        f"σ = {_NOISE:g}/255 is added, without which periods of a generated record are the same, bit for bit.",
    ),
    "noise": Ablation(
        "Noise of the pictures",
        "How much noise it tolerates",
        ("modal", "paper-tuned", "paper"),
        (
            Row("none added", tick="0"),
            *(Row(f"σ = {s:g}/255", noise=s, tick=f"{s:g}") for s in (1.0, 2.0, 5.0, 10.0)),
        ),
        ("displacement_error", "displacement_error_observed", "static_leak", "amplitude_ratio", "total_s"),
        picture="displacement_error",
        x_label="standard deviation of the noise, of 255",
        remark="Normal noise, independent in every pixel, colour and picture, on the training pictures where they are "
        "not transparent.",
    ),
    "amplitude": Ablation(
        "Amplitude of the motion",
        "From a hundredth of a pixel to one",
        ("modal", "paper-tuned", "paper"),
        tuple(
            Row(f"{a:g} px", amplitude_px=a, tick=f"{a:g}") for a in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
        ),
        ("displacement_error", "static_leak", "amplitude_ratio", "direction_error_deg", "total_s"),
        picture="displacement_error",
        x_label="largest displacement in the first training camera, pixels",
        remark="Ground truth is made where α times the amplitude, the motion that is added, is 1, 2, 4 and 8 pixels: "
        "the columns are those.",
    ),
    "capture": Ablation(
        "Kind of capture",
        "The same scene and motion, filmed as people do",
        ("modal",),
        tuple(Row(kind, kind=kind, apart=True) for kind in KINDS),
        (
            "displacement_error",
            "static_leak",
            "amplitude_ratio",
            "direction_error_deg",
            "frequency_error_hz",
            "total_s",
        ),
        picture="displacement_error",
        x_label="kind of capture",
        remark="sweep: one fixed camera, after photographs from all sides; handheld: one camera in a hand; rig: eight "
        "cameras whose clocks are off by up to half a second; clips: seven, one after another. All but orbit at "
        "3.4 Hz, which is no whole number of periods. The longer recordings have fewer and other test views, so "
        "compare SSIM with the rows nothing moves and ceiling of the same kind, not between kinds.",
    ),
}
# Rows that differ between presets.
_ITERATIONS = {
    "paper": _scaled("paper.iterations", 0.625, 0.75, 1, 1.5)
    + _scaled("paper.motion_iterations", 0.25, 0.5, 2),
    "modal": _scaled("motion.iterations", 0.125, 0.25, 0.5, 1, 2),
}


def find_ablation(name: str) -> Ablation:
    """Raises BenchError listing the names where there is no such ablation."""
    if name not in ABLATIONS:
        raise BenchError(f"ablation {name!r} is unknown; there are: {', '.join(ABLATIONS)}")
    return ABLATIONS[name]


def chosen_preset(name: str, preset: str | None) -> str:
    """The preset to vary. Raises BenchError for one that the ablation cannot."""
    able = find_ablation(name).presets
    if preset is None:
        return able[0]
    if preset not in able:
        raise BenchError(f"--preset {preset}: the ablation {name} varies {', '.join(able)}")
    return preset


def rows_of(name: str, preset: str, given: Mapping[str, str]) -> tuple[Row, ...]:
    """The variants for the preset that is varied, with complete settings: `given` by the user, and over them the row's.

    A multiple is of the user's value, else of the preset's. Raises BenchError where that is 0, which stands for "by the
    data".
    """
    if name == "iterations":
        rows = _ITERATIONS["modal" if preset == "modal" else "paper"]
    elif name == "filter-phase":
        rows = _filters("linear") + (() if preset == "modal" else _filters("phase"))
    else:
        rows = find_ablation(name).rows
    return tuple(_complete(row, preset, given) for row in rows)


def _complete(row: Row, preset: str, given: Mapping[str, str]) -> Row:
    settings, label = {**given, **row.settings}, row.label
    for name, factor in row.scalings.items():
        stage, _, key = name.partition(".")
        default: Any = getattr(preset_named(preset).defaults[stage], key)
        base = type(default)(given.get(name, default))
        if not base:
            raise BenchError(
                f"setting {name} is {base}: give a number with --set, since the ablation uses multiples of it"
            )
        whole = isinstance(default, int)
        settings[name] = str(max(round(base * factor), 1)) if whole else f"{base * factor:.12g}"
        label = f"{name} = {settings[name]}"
    return replace(row, label=label, settings=settings, scalings={})


def filter_figures(kind: str | None, data: BenchSet) -> dict[str, float]:
    """What the filter alone does to the motion's frequency f: arg H(f) in degrees (ahead: positive), and |H(f) − 1|."""
    response = TemporalFilter(kind or "zero-phase").response(data.band_hz, [data.frequency_hz], data.fps)[0]
    return {
        "filter_phase_deg": float(np.degrees(np.angle(response))),
        "filter_error": float(abs(response - 1)),
    }
