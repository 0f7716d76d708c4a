"""Conversion of rendered linear light to picture files: background, sensor model, file format.

The model of a sensor is that of EMVA 1288 without fixed patterns: electrons ~ Poisson(light) + Normal(0, read
noise), in linear light, each colour channel and each pixel by itself (no mosaic of colour filters, no blur). Sub-
pixel motion changes a pixel by far less than a grey level; whether it survives this noise is what such data asks.

Noise depends on its key (seed, split, timestep, view, α …) alone: independent from picture to picture, the
same whatever order pictures are made in. NumPy may change how it draws Poisson numbers in a new version.
"""

import hashlib
import io
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.colour import to_display, to_linear
from tg4mm.core.pictures import exr, png

from .errors import GenerateError, check_choice, check_whole, check_within

IMAGES = ("png8", "png16", "exr")
BACKGROUNDS = ("transparent", "white")


def to_integers(values: np.ndarray, bits: int) -> np.ndarray:
    """Values in 0 … 1, clipped, to the nearest of 0 … 2^bits − 1: uint8 for 8 bits, uint16 for 16."""
    if bits not in (8, 16):
        raise ValueError(f"{bits} bits; a picture has 8 or 16")
    scaled = np.clip(values, 0.0, 1.0) * (2**bits - 1)
    return np.floor(scaled + 0.5).astype(np.uint8 if bits == 8 else np.uint16)


def straight(premultiplied: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return [H, W, 4] premultiplied to colours [H, W, 3], 0 where alpha is 0, and alpha [H, W] in 0 … 1."""
    alpha = np.clip(premultiplied[..., 3], 0.0, 1.0)
    divisor = np.where(alpha > 0, alpha, 1)[..., None]
    return np.where(alpha[..., None] > 0, premultiplied[..., :3] / divisor, 0), alpha


def over_white(premultiplied: np.ndarray) -> np.ndarray:
    """Return [H, W, 4] linear and premultiplied, over white: [H, W, 3] linear.

    The sum is taken on display-referred values (docs/conventions.md, "Images"), so the picture is the one that
    a reader makes of the transparent file, and edges lie in the same place. Opaque pixels stay as they are, those
    brighter than white too.
    """
    colour, alpha = straight(premultiplied)
    weight = alpha[..., None]
    return np.where(weight == 1, colour, to_linear(to_display(colour) * weight + (1 - weight)))


Key = tuple[int | str, ...]


@dataclass(frozen=True)
class ImageSensor:
    """A sensor and how it is exposed. Raises GenerateError on construction if a value is out of range.

    Linear light 1.0 (display white) fills `exposure` of the full well: less is a darker scene or a shorter
    exposure, made as bright again by gain. So white is full_well · exposure electrons, and one grey value is
    one electron times the gain 1 / (full_well · exposure).
    """

    name: str = "custom"
    full_well: float = 10_000.0  # electrons that a pixel holds
    read_noise: float = 2.5  # electrons, standard deviation
    exposure: float = 1.0  # in 0 … 1
    adc_bits: int = 12  # of the converter behind the pixels, which counts up to the full well
    jpeg_quality: int | None = None  # 1 … 100; None: no JPEG

    def __post_init__(self) -> None:
        check_within("sensor: full_well", self.full_well, 1, 1e7, "electrons")
        check_within("sensor: read_noise", self.read_noise, 0, self.full_well, "electrons")
        check_within("sensor: exposure", self.exposure, 0, 1, "of the full well", above=True)
        check_whole("sensor: adc_bits", self.adc_bits, 4, 24)
        if self.jpeg_quality is not None:
            check_whole("sensor: jpeg_quality", self.jpeg_quality, 1, 100)

    @classmethod
    def preset(cls, name: str) -> "ImageSensor | None":
        """A sensor by name; None for "none", the picture as the renderer gives it."""
        if name == "none":
            return None
        if name not in PRESETS:
            raise GenerateError(f"--sensor {name!r} is not one of none, {', '.join(PRESETS)}")
        return PRESETS[name]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "ImageSensor":
        return cls(**data)


# Typical of their kind, not of one product: full well and read noise as data sheets give them.
PRESETS = {
    sensor.name: sensor
    for sensor in (
        ImageSensor("machine-vision", full_well=10_500, read_noise=2.4, exposure=0.9, adc_bits=12),
        ImageSensor("phone", full_well=6_000, read_noise=1.8, exposure=0.4, adc_bits=10, jpeg_quality=92),
        ImageSensor("high-speed", full_well=25_000, read_noise=18.0, exposure=0.3, adc_bits=12),
        ImageSensor("scientific", full_well=30_000, read_noise=1.4, exposure=0.9, adc_bits=16),
    )
}


def expose(sensor: ImageSensor, linear: np.ndarray, key: Key) -> np.ndarray:
    """Return the sensor's reading of linear light [H, W, 3] ≥ 0, as linear light, float64.

    Clipped at the full well, and at 0, as pictures are whose black level was subtracted: the mean is that of
    the light except within some standard deviations of either end.
    """
    rng = generator(key)
    white = sensor.full_well * sensor.exposure  # electrons at linear 1.0
    # A pixel full many times over is full; Poisson numbers of 1e30 do not exist.
    light = np.clip(np.asarray(linear, np.float64) * white, 0.0, 4.0 * sensor.full_well)
    electrons = rng.poisson(light) + rng.normal(0.0, sensor.read_noise, light.shape)
    steps = 2**sensor.adc_bits - 1
    counts = np.rint(np.clip(electrons / sensor.full_well, 0.0, 1.0) * steps)
    return counts / steps / sensor.exposure


def capture(
    sensor: ImageSensor, linear: np.ndarray, alpha: np.ndarray | None, key: Key, bits: int = 8
) -> np.ndarray:
    """One picture by a sensor: display-referred sRGB [H, W, 3], or with alpha [H, W, 4], uint8 or uint16.

    Parameters: `linear` [H, W, 3] float, linear light of the surfaces, not multiplied by alpha; `alpha`
    [H, W] float in 0 … 1, None for an opaque picture: it gets no noise, and where it is 0 the colour stays 0;
    `key`, whole numbers and words that no other picture has; `bits`, 8 or 16.
    Raises GenerateError where JPEG, which has neither alpha nor 16 bits, is asked for these.
    """
    if linear.ndim != 3 or linear.shape[-1] != 3 or (alpha is not None and alpha.shape != linear.shape[:2]):
        shape = None if alpha is None else alpha.shape
        raise ValueError(f"linear has shape {linear.shape}, alpha {shape}; expected (H, W, 3) and (H, W)")
    if sensor.jpeg_quality is not None and (bits != 8 or alpha is not None):
        what = "transparent backgrounds" if alpha is not None else f"{bits} bits"
        raise GenerateError(
            f"--sensor {sensor.name} compresses with JPEG, which has no {what}: use --background white and "
            "--images png8, or a sensor without jpeg_quality"
        )
    rgb = to_integers(to_display(expose(sensor, linear, key)), bits)
    if sensor.jpeg_quality is not None:
        rgb = _jpeg(rgb, sensor.jpeg_quality)
    if alpha is None:
        return rgb
    rgb = np.where(alpha[..., None] > 0, rgb, 0).astype(rgb.dtype)
    return np.concatenate([rgb, to_integers(alpha, bits)[..., None]], axis=-1)


def generator(key: Key) -> np.random.Generator:
    """The random numbers of a key: a counter-based generator, seeded by a hash of it."""
    for part in key:
        if isinstance(part, bool) or not isinstance(part, int | str | np.integer):
            raise ValueError(f"{part!r} in the key {key!r} is neither a whole number nor a word")
    text = "\n".join(f"{'s' if isinstance(part, str) else 'i'}{part}" for part in key)
    digest = hashlib.sha256(text.encode()).digest()
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(int.from_bytes(digest, "little"))))


def _jpeg(rgb: np.ndarray, quality: int) -> np.ndarray:
    """Return [H, W, 3] uint8 through a baseline JPEG with 4:2:0 colours, as cameras write them."""
    try:
        from PIL import Image
    except ImportError as error:
        raise GenerateError(
            "a sensor with jpeg_quality needs the package Pillow, which this Python lacks: install it or use "
            "a sensor without JPEG"
        ) from error
    packed = io.BytesIO()
    Image.fromarray(rgb).save(packed, "JPEG", quality=quality, subsampling="4:2:0")
    with Image.open(packed) as image:
        return np.asarray(image.convert("RGB"))


@dataclass(frozen=True)
class PictureFormat:
    """Kind of the picture files. Raises GenerateError on construction for a kind that is unknown.

    PNG holds display-referred sRGB with straight alpha, 8 or 16 bits; EXR linear light with premultiplied
    alpha, 16-bit floats. A white background makes pictures opaque, without an alpha channel.
    """

    images: str = "png8"
    background: str = "transparent"

    def __post_init__(self) -> None:
        check_choice("--images", self.images, IMAGES)
        check_choice("--background", self.background, BACKGROUNDS)

    @property
    def suffix(self) -> str:
        return ".exr" if self.images == "exr" else ".png"

    @property
    def bits(self) -> int:
        """Return the bits per channel of a PNG."""
        return 8 if self.images == "png8" else 16

    @property
    def channels(self) -> int:
        return 3 if self.background == "white" else 4

    def check_sensor(self, sensor: ImageSensor | None) -> None:
        """Raises GenerateError for a sensor whose pictures this format cannot hold."""
        if sensor is None:
            return
        if self.images == "exr":
            raise GenerateError("--sensor quantises to 8 or 16 bits; --images exr cannot be combined with it")
        if sensor.jpeg_quality is not None and (self.bits != 8 or self.background != "white"):
            raise GenerateError(
                f"--sensor {sensor.name} compresses with JPEG, which needs --images png8 and --background white"
            )

    def pixels(
        self,
        linear: np.ndarray,
        sensor: ImageSensor | None = None,
        key: Key = (),
        gain: np.ndarray | None = None,
    ) -> np.ndarray:
        """The numbers that the file will hold, [H, W, C]: uint8 or uint16 for PNG, float32 for EXR.

        Parameters: `linear` [H, W, 4] float32, linear Rec.709 and premultiplied, row 0 on top; `sensor`, and
        the key of its noise: what no other picture has, (seed, split, timestep, view, α) say; `gain` [3] or [H, 1, 3],
        factors on red, green and blue before the sensor, background and all.
        """
        if linear.ndim != 3 or linear.shape[2] != 4:
            raise ValueError(f"linear has shape {linear.shape}, expected (H, W, 4)")
        if sensor is not None:
            self.check_sensor(sensor)
        opaque = self.background == "white"
        if gain is not None and not opaque:
            raise ValueError("a gain acts on the background too: it needs an opaque picture")
        if self.images == "exr" and not opaque:
            return linear
        colour, alpha = (over_white(linear), None) if opaque else straight(linear)
        if gain is not None:
            colour = colour * gain.astype(colour.dtype)
        if self.images == "exr":
            return colour
        if sensor is not None:
            return capture(sensor, colour, alpha, key, self.bits)
        rgb = to_integers(to_display(colour), self.bits)
        return rgb if alpha is None else np.concatenate([rgb, to_integers(alpha, self.bits)[..., None]], -1)

    def encode(
        self,
        linear: np.ndarray,
        sensor: ImageSensor | None = None,
        key: Key = (),
        gain: np.ndarray | None = None,
    ) -> bytes:
        """The file of one picture; parameters as for `pixels`."""
        numbers = self.pixels(linear, sensor, key, gain)
        return exr.encode(numbers) if self.images == "exr" else png.encode(numbers)

    def complete(self, path: Path, width: int, height: int) -> bool:
        """Return whether a complete file of this kind and size exists; its pixels are not decoded."""
        if self.images == "exr":
            return exr.complete(path, width, height)
        return png.complete(path, width, height, (self.bits, self.channels))
