"""The generator's settings, one frozen description checked on entry, and the engine settings they imply."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from tg4mm.core.values import Number

from .cameras import CameraSetup
from .effects import Effects
from .errors import GenerateError, check_choice, check_whole
from .pictures import ImageSensor, PictureFormat
from .vibration import MotionDescription

TRUTH = ("none", "test", "all")
NOISE = ("state", "picture")
SECOND = "second"  # a built-in scene's other motion, of which development knows nothing
KINDS = ("builtin", "blend", "mesh")
ENGINES = ("cycles", "eevee")
DEVICES = ("cpu", "gpu", "auto")
_LIMIT_SIZE = (8, 4096)
_PLAIN = ("scene", "size", "samples", "seed", "noise", "truth", "points", "engine", "device")


@dataclass(frozen=True)
class Source:
    """The source of the geometry: a built-in scene by name, or a user's file."""

    kind: str = "builtin"  # one of KINDS
    path: str = ""  # of the file, absolute; "" for a built-in scene
    frame: int | None = None  # of a .blend; None: the one it was saved at
    scene: str | None = None  # of a .blend; None: the one it was saved in


@dataclass(frozen=True)
class Settings:
    """Options of a dataset. Raises GenerateError on construction if one is out of range."""

    scene: str  # built-in scene, or what the user's file is called: first part of the folder's name
    motion: MotionDescription
    cameras: CameraSetup  # also number of timesteps and frame rate
    source: Source = field(default_factory=Source)
    size: int = 128  # edge of the square images, pixels
    alphas: tuple[float, ...] = (5, 10, 20, 50, 100)  # magnification factors of the ground truth
    samples: int = 96  # light paths per pixel
    seed: int = 0  # of the renderer, the sensor and whatever else is random
    noise: str = "state"  # pictures of one state share the renderer's, or each picture has its own
    truth: str = "test"  # splits with per-pixel truth
    points: int = 20000  # of points3d.ply
    engine: str = "cycles"
    device: str = "cpu"
    pictures: PictureFormat = field(default_factory=PictureFormat)
    sensor: ImageSensor | None = None  # None: what the renderer gives, without the noise of a camera
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        check_whole("--size", self.size, *_LIMIT_SIZE)
        check_whole("--samples", self.samples, 1, 65536)
        check_whole("--seed", self.seed, 0, 2**31 - 1)
        check_whole("--points", self.points, 0, 10_000_000)
        for alpha in self.alphas:
            if not (Number(1, 999).fits(alpha) and alpha == int(alpha)):
                raise GenerateError(
                    f"--alphas {alpha!r}: a magnification factor is a whole number in 1 … 999"
                )
        if len(set(self.alphas)) != len(self.alphas):
            raise GenerateError(f"--alphas {','.join(f'{a:g}' for a in self.alphas)} names a factor twice")
        check_choice("--truth", self.truth, TRUTH)
        check_choice("--noise", self.noise, NOISE)
        check_choice("--engine", self.engine, ENGINES)
        check_choice("--device", self.device, DEVICES)
        self.pictures.check_sensor(self.sensor)
        self.effects.check(self.pictures, self.size, self.timesteps)
        self.effects.check_times(self.fps, self.cameras.kind == "handheld")
        if self.noise == "picture" and self.engine == "eevee":
            raise GenerateError("--noise picture needs --engine cycles: eevee has no seed")
        passing = next((mode for mode in self.motion.modes if not mode.steady), None)
        if self.cameras.kind == "clips" and passing is not None:
            raise GenerateError(
                f"--cameras clips needs a steady vibration; mode {passing.name!r} "
                f"{'rings down' if passing.frequency_hz else 'is a drift'}"
            )

    @property
    def timesteps(self) -> int:
        return self.cameras.n_timesteps

    @property
    def fps(self) -> float:
        """Timesteps per second, Hz."""
        return self.cameras.fps

    @property
    def folder(self) -> str:
        """Name of the dataset's folder, "mic_5Hz_0_005": decimal points become underscores."""
        main = self.motion.main
        amplitude = _plain(main.amplitude_px) + "px" if main.amplitude_px else _plain(main.amplitude or 0.0)
        return f"{self.scene}_{_plain(main.frequency_hz)}Hz_{amplitude}"

    def to_json(self) -> dict[str, Any]:
        """Plain data; `from_json` gives the same settings again."""
        return {
            **{name: getattr(self, name) for name in _PLAIN}, "alphas": list(self.alphas),
            "motion": self.motion.to_json(), "cameras": self.cameras.to_json(), "source": asdict(self.source),
            "pictures": asdict(self.pictures), "sensor": self.sensor.to_json() if self.sensor else None,
            "effects": self.effects.to_json(),
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "Settings":
        return cls(
            **{name: data[name] for name in _PLAIN},
            alphas=tuple(data["alphas"]),
            motion=MotionDescription.from_json(data["motion"]),
            cameras=CameraSetup.from_json(data["cameras"]),
            source=Source(**data["source"]),
            pictures=PictureFormat(**data["pictures"]),
            sensor=ImageSensor.from_json(data["sensor"]) if data["sensor"] else None,
            effects=Effects(**data["effects"]),
        )


def motion_file(scene: str, asked: Path | None = None) -> Path:
    """A description of motion: the file `asked` for, else a built-in scene's own, for the word `second` its other."""
    if asked is not None and (asked != Path(SECOND) or asked.exists()):
        return asked
    return Path(__file__).parent / "scenes" / f"{scene}{'' if asked is None else f'_{SECOND}'}.yaml"


def _plain(value: float) -> str:
    """A number without exponent, its decimal point as an underscore."""
    text = f"{value:.12f}".rstrip("0").rstrip(".")
    if not text or float(text) == 0.0:
        raise GenerateError(f"{value!r} is too small to name a folder after")
    return text.replace(".", "_")


@dataclass(frozen=True)
class Quality:
    """Size, samples, seed, engine and device of a picture.

    Threads do not change a byte, so they are not described. The device does, in the last bits.
    """

    width: int
    height: int
    samples: int
    seed: int
    threads: int = 0  # 0: all cores
    engine: str = "cycles"  # or "eevee", for pictures only: truth is always by Cycles
    device: str = "cpu"  # of Cycles: "cpu", "gpu" or "auto"

    @classmethod
    def of(cls, settings: Settings, threads: int = 0) -> "Quality":
        size = settings.size
        return cls(size, size, settings.samples, settings.seed, threads, settings.engine, settings.device)

    def finer(self, size: int, fineness: int) -> "Quality":
        """Quality of a picture with `fineness` times as many pixels along an edge and as many light paths in all."""
        samples = max(1, round(self.samples / fineness**2))
        return replace(self, width=size, height=size, samples=samples)

    def describe(self) -> dict[str, object]:
        """Return the engine settings that `scene.json` records, apart from the seed."""
        shared: dict[str, object] = {"samples": self.samples, "view_transform": "Standard", "dither": 0.0}
        if self.engine == "eevee":
            return {"name": "EEVEE", **shared, "pixel_filter": "BLACKMAN_HARRIS 1.5 px", "ray_tracing": True}
        return {
            "name": "CYCLES", **shared, "device": self.device, "denoiser": None, "adaptive_sampling": False,
            "pixel_filter": "BLACKMAN_HARRIS 1.5 px",
        }  # fmt: skip
