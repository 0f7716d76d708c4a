"""The camera effects on the training pictures of a record."""

from dataclasses import asdict, dataclass
from typing import Any

from ..errors import GenerateError, check_choice, check_whole, check_within
from ..pictures import PictureFormat

CODECS = ("none", "h264")
_MOST_SHAKE = 20.0  # pixels
_MOST_PERCENT = 90.0


@dataclass(frozen=True)
class Effects:
    """Effects on the training pictures of a record, each off by default, in any combination.

    Pictures of a sweep, which are photographs, have none, nor have test views and magnified truth. Raises
    GenerateError on construction if a value is out of range.
    """

    shake_px: float = 0.0  # rms shift of the picture by a camera that shakes about its own centre
    # percent, peak to peak over the record; white balance drifts by a third of it
    exposure_drift: float = 0.0
    flicker: float = 0.0  # percent, peak to peak, of the light
    flicker_hz: float = 100.0
    codec: str = "none"  # what the pictures of each camera go through as one video
    crf: int = 20  # x264's constant rate factor: 0 keeps everything, 51 almost nothing
    keep_video: bool = False
    readout_ms: float = 0.0  # rolling shutter of fixed cameras: from a picture's first row to its last
    shutter_ms: float = 0.0  # exposure of fixed cameras, whose pictures show the mean over it: motion blur

    def __post_init__(self) -> None:
        check_within("--shake", self.shake_px, 0, _MOST_SHAKE, "pixels")
        check_within("--exposure-drift", self.exposure_drift, 0, _MOST_PERCENT, "percent")
        check_within("--flicker", self.flicker, 0, _MOST_PERCENT, "percent")
        check_within("--flicker-hz", self.flicker_hz, 0, 1e6, "Hz", above=True)
        check_choice("--codec", self.codec, CODECS)
        check_whole("--crf", self.crf, 0, 51)
        check_within("--readout", self.readout_ms, 0, 1e3, "milliseconds")
        check_within("--shutter", self.shutter_ms, 0, 1e3, "milliseconds")

    @property
    def gain(self) -> bool:
        """Return whether the brightness varies from frame to frame."""
        return self.exposure_drift > 0 or self.flicker > 0

    @property
    def coded(self) -> bool:
        """Return whether the pictures of each camera are encoded as a video."""
        return self.codec != "none"

    @property
    def any(self) -> bool:
        return self.gain or self.coded or max(self.shake_px, self.readout_ms, self.shutter_ms) > 0

    def check_times(self, fps: float, is_moving: bool) -> None:
        """Raises GenerateError where rows cannot be read, or light be gathered, at times of their own."""
        given = {"--readout": self.readout_ms, "--shutter": self.shutter_ms}
        for option, ms in given.items():
            if ms > 1e3 / fps:
                raise GenerateError(
                    f"{option} {ms:g} is more than the {1e3 / fps:.4g} ms of a frame at --fps {fps:g}"
                )
            if ms and (is_moving or self.shake_px):
                other = "--cameras handheld" if is_moving else f"--shake {self.shake_px:g}"
                raise GenerateError(f"{option} {ms:g} is for cameras that stand still, not with {other}")
        if all(given.values()):
            raise GenerateError(
                f"--shutter {self.shutter_ms:g} blurs whole pictures, so it excludes --readout {self.readout_ms:g}"
            )

    def check(self, pictures: PictureFormat, size: int, timesteps: int) -> None:
        """Raises GenerateError where such a record cannot be, one line with the option and what to do."""
        white, option = (
            pictures.background == "white",
            "--exposure-drift" if self.exposure_drift else "--flicker",
        )
        if self.any and timesteps < 2:
            raise GenerateError(
                "--timesteps 1: shake, drift, flicker, readout, shutter and a codec need at least 2 timesteps"
            )
        if self.gain and not white:
            raise GenerateError(f"{option} acts on the whole picture: use --background white")
        if self.coded and (not white or pictures.images != "png8"):
            raise GenerateError(f"--codec {self.codec} needs --background white and --images png8")
        if self.coded and size % 2:
            raise GenerateError(f"--size {size}: --codec {self.codec} at 4:2:0 needs an even number")

    def to_json(self) -> dict[str, Any]:
        data = asdict(self)
        for name in ("readout_ms", "shutter_ms"):  # as in sets that were made before there was one
            if not data[name]:
                del data[name]
        return data
