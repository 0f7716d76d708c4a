"""From what the renderer gives, linear light, to the bytes of a picture: background, sensor, file format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import exr, png
from .colour import over_white, straight, to_display, to_integers
from .errors import GenerateError
from .limits import check_choice
from .sensor import Key, Sensor, capture

IMAGES = ("png8", "png16", "exr")
BACKGROUNDS = ("transparent", "white")


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
        """Per channel; of a PNG."""
        return 8 if self.images == "png8" else 16

    @property
    def channels(self) -> int:
        return 3 if self.background == "white" else 4

    def check_sensor(self, sensor: Sensor | None) -> None:
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
        sensor: Sensor | None = None,
        key: Key = (),
        gain: np.ndarray | None = None,
    ) -> np.ndarray:
        """The numbers that the file will hold, [H, W, C]: uint8 or uint16 for PNG, float32 for EXR.

        Parameters: `linear` [H, W, 4] float32, linear Rec.709 and premultiplied, row 0 on top; `sensor`, and
        the key of its noise: what no other picture has, (seed, split, timestep, view, α) say; `gain` [3], factors
        on red, green and blue before the sensor, background and all.
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
        sensor: Sensor | None = None,
        key: Key = (),
        gain: np.ndarray | None = None,
    ) -> bytes:
        """The file of one picture; parameters as for `pixels`."""
        numbers = self.pixels(linear, sensor, key, gain)
        return exr.encode(numbers) if self.images == "exr" else png.encode(numbers)

    def complete(self, path: Path, width: int, height: int) -> bool:
        """Whether a file is there, of this kind and size, and whole; its pixels are not decoded."""
        if self.images == "exr":
            return exr.complete(path, width, height)
        return png.complete(path, width, height, self.bits, self.channels)
