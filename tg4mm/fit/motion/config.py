"""Settings of the motion stage, preset `modal`."""

from dataclasses import dataclass, replace

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import check_band
from tg4mm.core.options import setting
from tg4mm.core.values import NOT_NEGATIVE, POSITIVE, SEED, Choice, Number, require

FASTEST = 1e9  # Hz, where the frame rate is not known yet
MOST_REDUCED = 16
# Gaussians from which the solver has patches (`preconditioner.py`); the iterations then: 20 reach what 14 do without
_PATCHED, _OF_PATCHES = 16_384, 1.5
NUISANCE = ("auto", "none", "exposure", "all")
_RULES = {
    "components": Number(1, 100_000),
    "smoothness_weight": NOT_NEGATIVE,
    "ridge": POSITIVE,
    "iterations": Number(1, 1_000_000),
    "tolerance": Number(1e-6, 1, below=True),  # 1e-6: what float32 holds
    "gauss_newton": Number(0, 1_000),
    "nuisance": Choice(*NUISANCE),
    "seed": SEED,
}


@dataclass(frozen=True)
class MotionConfig:
    """Settings of the motion fit. Weights are relative to the images' mean information about a Gaussian."""

    components: int = setting(
        16, "largest number of functions of time; fewer if the others are noise", "functions of time"
    )
    smoothness_weight: float = setting(
        0.0, "weight of the prior that neighbours move alike; 0: found from the images"
    )
    ridge: float = setting(1e-3, "weight that draws motion to zero where the images hold no information")
    iterations: int = setting(
        14,
        "largest number of iterations of conjugate gradients for each component; half as many again from 16,384 "
        "Gaussians on",
        "iterations",
    )
    tolerance: float = setting(3e-3, "relative residual at which conjugate gradients stop")
    split_half: bool = setting(
        True, "fit the halves of the data separately, keep what they agree on; needed for the uncertainty"
    )
    gauss_newton: int = setting(
        4,
        "largest number of Gauss-Newton iterations; used if 1 % of the visible scene moves by more than 0.7 pixels "
        "(0.35 with six cameras or more)",
        "iterations",
    )
    appearance: bool = setting(
        True, "fit changes of colour (gloss, shadows) that motion does not explain; they are magnified, too"
    )
    sinusoids: bool = setting(
        True,
        "fit a vibration that exceeds the noise as a sinusoid, not as principal components over time",
    )
    attenuation: bool = setting(
        True, "correct the attenuation of least squares, estimated with the other half of the pictures"
    )
    nuisance: str = setting(
        "auto",
        "changes removed from every frame: none; exposure (gain and offset); all (exposure and camera pose); "
        "auto: those that are detected",
    )
    band: str = setting(
        "",
        "LOW HIGH: a frequency there is fitted even if none is detected; empty: detected ones only",
        "Hz",
    )
    region: str = setting(
        "",
        "where motion may be, in the picture of the one fixed camera: a PNG's path (white), or a polygon "
        "X,Y X,Y X,Y …; empty: everywhere",
    )
    reduce: str = setting(
        "",
        "a whole number k: squares of k × k pixels are averaged before the motion of fixed cameras is fitted; 1: none; "
        "empty: chosen, above 1 for long recordings of large pictures",
        "pixels",
    )
    seed: int = setting(0, "seed of the random generator")


def checked(config: MotionConfig) -> MotionConfig:
    """`config`. Raises Tg4mmError on a value out of range."""
    for name, rule in _RULES.items():
        require(f"setting motion.{name}", getattr(config, name), rule, Tg4mmError)
    asked_band(config.band)
    asked_factor(config.reduce)
    return config


def asked_factor(text: str) -> int | None:
    """`motion.reduce`; None where it is left to the recording. Raises Tg4mmError for what is no whole number."""
    if not text.strip():
        return None
    if not text.strip().isdecimal() or not 1 <= int(text) <= MOST_REDUCED:
        raise Tg4mmError(
            f"setting motion.reduce is {text[:60]!r}, expected a whole number, 1 to {MOST_REDUCED}"
        )
    return int(text)


def asked_band(text: str, fps: float = FASTEST) -> tuple[float, float] | None:
    """`motion.band` as (low, high) in Hz; None where no band is asked for. Raises Tg4mmError for what is no band."""
    if not text.strip():
        return None
    try:
        low, high = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise Tg4mmError(
            f"setting motion.band is {text[:60]!r}, expected two frequencies in Hz, LOW HIGH"
        ) from None
    return check_band((low, high), fps)


def resolved(config: MotionConfig, n_gaussians: int) -> MotionConfig:
    """The settings for so many Gaussians. Raises Tg4mmError on a value out of range."""
    factor = _OF_PATCHES if n_gaussians >= _PATCHED else 1.0
    return replace(checked(config), iterations=round(config.iterations * factor))
