"""Options of the commands that show a video or a run: look, render, measure, analyse, report, view, export, process."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tg4mm.capture.options import (
    INPUT,
    RecordingConfig,
    keep_duplicates_option,
    length_file_option,
    sfm_config,
    threads_option,
)
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import (
    ALPHA,
    REQUIRED,
    RUN,
    Band,
    Device,
    MagnifyOptions,
    argument,
    band_option,
    device_option,
    empty_band_option,
    option,
    parse_bands,
    parse_timesteps,
    regions_option,
    settings_option,
)

if TYPE_CHECKING:
    from tg4mm.capture.options import SfmConfig
    from tg4mm.core.regions import Regions, Scale
    from tg4mm.show.measure import Measurement, Sensor
    from tg4mm.show.report.sources import Shown

ONE_BAND = "--band is given {} times; expected once: one band is magnified"


def _only_band(texts: Sequence[str]) -> tuple[Band | None, ...]:
    bands = parse_bands(texts)
    if len(bands) > 1:
        raise Tg4mmError(ONE_BAND.format(len(bands)))
    return bands


def _one_band_option() -> Any:
    return option(
        (),
        "Magnify only frequencies LO ≤ f ≤ HI, Hz. auto: a band around the strongest vibration. [default: all]",
        name="--band",
        metavar="LO HI | auto",
        given=tuple[str, ...],
        into=_only_band,
    )


def _sensors(texts: Sequence[str]) -> "tuple[Sensor, ...]":
    if not texts:
        return ()
    from tg4mm.show.measure import parse_sensor

    return tuple(parse_sensor(text) for text in texts)


def _named_sensors(texts: Sequence[str]) -> "tuple[Sensor, ...]":
    if not texts:
        return ()
    from tg4mm.show.measure.sensors import checked_names

    return tuple(checked_names(list(_sensors(texts))))


def _sensor_option() -> Any:
    return option(
        (),
        "A sensor, as for tg4mm measure; may be repeated. [default: clusters that move alike, and all]",
        name="--sensor",
        metavar="NAME=REGION",
        given=tuple[str, ...],
        into=_named_sensors,
    )


@dataclass(frozen=True, kw_only=True)
class LookOptions:
    """Find in seconds what vibrates in a video of a fixed camera, without fitting a model.

    Divides the picture into cells, measures the shift of every cell in every picture (pixels), and tests lines (Hz)
    region by region, the strongest first. Prints frequencies and amplitudes with standard deviations and positions,
    independently moving regions, changes of light, the smallest motion that would be found, what the record cannot
    resolve, and the next command. A picture shows the regions on the first frame and the composite spectrum.
    """

    video: Path = argument(
        "VIDEO", "A video of a camera that stands still, or a folder of numbered pictures."
    )
    fps: float | None = option(
        None,
        "True frame rate of the recording, Hz, if the file states another one (slow motion) or none (a folder). "
        "[default: the file's own times]",
        metavar="HZ",
    )
    readout: float | None = option(
        None,
        "Rolling shutter: milliseconds from a picture's first row to its last. [default: global shutter]",
        metavar="MS",
    )
    start: float = option(0.0, "Where to begin in the video.", name="--from", unit="seconds")
    until: float | None = option(
        None, "Where to stop, seconds from the video's beginning. [default: its end]", unit="seconds"
    )
    keep_duplicates: bool = keep_duplicates_option()
    regions: Path | None = option(None, "Regions and a scale drawn with tg4mm view (JSON).", metavar="FILE")
    out: Path | None = option(None, "Folder for look.html, look.json and look.png.")
    png: Path | None = option(
        None,
        "PNG file to write the picture to. [default: OUT/look.png; if --out is not given, NAME-look.png in the current "
        "folder]",
    )


class PathOf(StrEnum):
    """The path that the camera follows."""

    capture = "capture"


class Split(StrEnum):
    """Cameras of the dataset."""

    test = "test"
    train = "train"


@dataclass(frozen=True, kw_only=True)
class RenderOptions(MagnifyOptions):
    """Render pictures and videos of a run, or of a splat file, with magnified motion.

    Writes OUT/<timestep>/<camera>.png and OUT/<camera>.mp4; with --orbit, OUT/r_000.png … and OUT/orbit.mp4; with
    --path, OUT/r_000.png … and OUT/path.mp4. Give one of --split, --cameras, --orbit and --path.
    """

    run: Path = argument("RUN", "A run folder made by tg4mm train, or a splat file with --cameras.")
    alpha: tuple[float, ...] = option(
        REQUIRED,
        f"{ALPHA}; 0 as captured, -1 at rest, below -1 inverted. With several --band give one for each.",
    )
    out: Path = option(REQUIRED, "Folder for the pictures; finished pictures are not repeated.")
    suppressed: bool = option(False, "With phase: remove all motion outside the bands, as in 3DMM.")
    amplitude_percentile: float = option(
        0.0, "With phase: keep the phase where a sub-band's amplitude is below this percentile, as in 3DMM."
    )
    split: Split | None = option(None, "Cameras of the dataset. [default: test]")
    cameras: Path | None = option(None, "Cameras of a transforms.json file (NeRF or nerfstudio).")
    orbit: int | None = option(
        None,
        "Number of pictures on one orbit around the scene; back and forth if it was filmed from one side.",
        at_least=1,
    )
    path: PathOf | None = option(None, "capture: one video along the capture's path, picture t from pose t.")
    slow: float = option(1.0, "Slow motion: 2 plays at half speed.")
    video: bool = option(True, "Also write an mp4 for each camera.", off="--no-video")
    frequencies: str | None = option(
        None,
        "For a splat file with motion whose header line was lost in another program: the frequency of each mode. "
        "Without them it is drawn without motion.",
        metavar="HZ,HZ,…",
    )
    fps: float = option(30.0, "With --frequencies: timesteps per second.", unit="Hz")
    device: Device = device_option()


@dataclass(frozen=True, kw_only=True)
class MeasureOptions:
    """Measure displacement over time with virtual sensors.

    The displacement of a sensor is measured in the pictures, frame by frame, with a standard deviation for each sample
    (mm if the scale is known, else scene units). Its spectrum (Hz) has a noise floor and the peaks above it.
    """

    run: Path = argument(
        "RUN",
        "A run folder made by tg4mm train, or the video of a fixed camera, which needs no training and is measured in "
        "pixels.",
    )
    out: Path = option(REQUIRED, "Folder for measure.json, files of --formats, plots and animated pictures.")
    sensor: "tuple[Sensor, ...]" = option(
        (),
        "A sensor; may be given several times. REGION: all, box:X0,Y0,Z0,X1,Y1,Z1, sphere:X,Y,Z,RADIUS (scene units), "
        "pixel:CAMERA,X,Y[,RADIUS] (pixels of a training view), cluster:NUMBER, cluster:still. [default: clusters that "
        "move alike, and all]",
        metavar="NAME=REGION",
        given=tuple[str, ...],
        into=_sensors,
    )
    sensors: Path | None = option(None, "Sensors in a YAML file (docs/measure.md).", metavar="FILE")
    regions: "Regions | None" = regions_option()
    reference: str | None = option(None, "Reference sensor of phases and coherence. [default: the first]")
    band: Band | None = band_option(
        "Band in Hz in which every sensor gets a peak, detected or not. [default: the one given to train]"
    )
    formats: str = option(
        "csv,uff,mat,hdf5,xlsx",
        "Output formats, separated by commas: csv, uff (universal file), mat (MATLAB), hdf5, xlsx.",
        metavar="LIST",
    )
    keep: bool = option(
        True,
        "Keep a cache of the picture data in the run folder, so that the next call is fast; for a flat capture "
        "nothing is cached.",
        off="--no-keep",
    )
    animate: bool = option(True, "Write animated pictures of the shape at every peak.", off="--no-animate")
    fps: float | None = option(
        None, "Frame rate at which a video was filmed. [default: the file's own times]", metavar="HZ"
    )
    readout: float | None = option(
        None,
        "Rolling shutter of a video: milliseconds from a picture's first row to its last. [default: global shutter]",
        metavar="MS",
    )


@dataclass(frozen=True)
class AveragingOptions:
    """Options for the division of a record into segments."""

    window: str = option("hann", "Window of averaged spectra, by scipy's name.")
    segment_s: float | None = option(
        None, "Length of a segment. [default: eight averages]", name="--segment", unit="seconds"
    )
    overlap: float = option(0.5, "Overlap of consecutive segments, as a share of their length.")


@dataclass(frozen=True, kw_only=True)
class AnalyseOptions(AveragingOptions):
    """Options of an analysis: what is computed beside levels, spectra and phases."""

    channels: Sequence[str] = option(
        (),
        "A channel; may be repeated. [default: all]",
        name="--channel",
        metavar="SENSOR/AXIS",
        given=tuple[str, ...],
    )
    band: Band | None = band_option(
        "Band of levels and modes, Hz. [default: from two cycles in the record on]"
    )
    machine: str | None = option(
        None,
        "Zone of ISO 20816-1 for a machine of this class.",
        name="--machine-class",
        metavar="I|II|III|IV",
    )
    reference: Path | None = option(
        None, "CSV of an accelerometer or a hammer: transfer functions to it.", name="--with", metavar="FILE"
    )
    column: str | None = option(
        None, "Column of --with: the input. [default: the only one]", name="--input", metavar="COLUMN"
    )
    sync: str | None = option(
        None,
        "Column of --with: an accelerometer beside the first channel, to estimate the lag. [default: the input]",
        metavar="COLUMN",
    )
    lag: float | None = option(
        None, "The film's clock minus the instrument's. [default: estimated]", unit="seconds"
    )
    speed: str | None = option(
        None,
        "Revolutions per minute, whose orders are estimated. auto: the strongest line of the first channel.",
        metavar="RPM|auto",
    )
    tacho: Path | None = option(
        None,
        "Instead of --speed: a CSV file on the film's clock with pulse_s, one time per turn, or time_s and speed_rpm.",
        metavar="FILE",
    )
    orders: Sequence[float] = option(
        (),
        "An order of the speed; may be repeated. [default: 1 to 6]",
        name="--order",
        given=tuple[float, ...],
    )
    against: Path | None = option(
        None, "An earlier record of the same sensors, to report changes.", metavar="MEASURED"
    )
    modes: bool = option(False, "Modal parameters, by SSI-cov and FDD; with --with by LSCF, too.")


@dataclass(frozen=True, kw_only=True)
class AnalyseCommand(AnalyseOptions):
    """Compute engineering quantities with ±: mm/s rms, averaged spectra, transfer functions, modes, changes."""

    measured: Path = argument(
        "MEASURED",
        "A folder of tg4mm measure, a CSV file with a column of times (time_s), or a universal file.",
    )
    out: Path = option(REQUIRED, "Folder for analysis.json, CSV files and plots.")


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """Options for the content of a report beyond the run itself."""

    alpha: float | None = option(
        None,
        f"{ALPHA}. [default: the largest motion becomes about 4 % of the picture, its noise stays below a pixel]",
    )
    sensors: "Sequence[Sensor]" = _sensor_option()
    band: Band | None = None  # Hz, magnified; None: all frequencies
    scale: "Scale | None" = None  # of the sensors, marked in the picture
    shown: "Shown | None" = None  # a finished magnified video, whose α, band and pictures are used
    measurement: "Measurement | None" = None  # of these sensors; None: measured now
    orbit: Path | None = None  # a folder that render_orbit wrote, to show its video
    files: Mapping[str, Path] = field(
        default_factory=dict
    )  # further files or folders, listed with their size
    metrics: Mapping[str, Any] | None = None  # of `evaluate_run`; None: RUN/metrics.json, or `evaluate`
    evaluate: Callable[..., Any] | None = None  # scores a run whose dataset has ground truth; None: no scores


@dataclass(frozen=True, kw_only=True)
class ReportCommand(ReportOptions):
    """Write a report of a run: one HTML file.

    It shows videos, space-time slices, maps, spectra, measurements, warnings, settings, commands to repeat them, and
    errors if the dataset has ground truth. Lengths are in mm if the scale is known, else in scene units. The page needs
    no network.
    """

    run: Path = argument("RUN", RUN)
    out: Path | None = option(None, "The HTML file. [default: RUN/report.html]")
    bands: tuple[Band | None, ...] = _one_band_option()
    allow_empty_band: bool = empty_band_option()
    pdf: bool = option(
        False, "Also write a PDF beside the page; needs Chromium, Chrome, Edge, or the extra pdf."
    )


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Show a run in the browser, with sliders for α and band; or draw regions on a recording.

    The page can be opened on this machine only (127.0.0.1), at the address that is printed. Ctrl+C stops the server.
    """

    run: Path = argument(
        "INPUT",
        "A run folder made by tg4mm train, or the folder of tg4mm process. Or a video, a folder of its numbered "
        "pictures, or a dataset, to draw regions and a scale on.",
    )
    alpha: float | None = option(
        None,
        "Magnification at the start: a displacement δ becomes (1 + alpha) δ. [default: one at which the strongest "
        "motion can be seen]",
    )
    bands: tuple[Band | None, ...] = _one_band_option()
    regions: Path | None = option(
        None,
        "File of the regions, read if it exists. [default: NAME-regions.json in the current folder]",
        metavar="FILE",
    )
    fps: float | None = option(
        None, "Frame rate in Hz of a folder of pictures, or of slow motion.", metavar="HZ"
    )
    out: Path | None = option(None, "Folder for snapshots and clips. [default: RUN/view]")
    port: int = option(8474, "Port on 127.0.0.1; 0 takes a free one.")
    open: bool = option(True, "Open the page in the browser.", off="--no-open")


class Format(StrEnum):
    """File formats; docs/export.md describes them."""

    ply = "ply"
    ply_sequence = "ply-sequence"
    html = "html"
    gltf = "gltf"
    spz = "spz"
    usd = "usd"


class LowPass(StrEnum):
    """Content of the scales of exported Gaussians."""

    baked = "baked"
    none = "none"
    linear = "linear"


@dataclass(frozen=True, kw_only=True)
class ExportOptions(MagnifyOptions):
    """Write a run as files for viewers and for Blender.

    Lengths are in scene units.
    """

    run: Path = argument("RUN", RUN)
    out: Path = option(
        REQUIRED,
        "Output file, or output folder for a sequence. With spz, a name ending in .spz writes the scene at rest, any "
        "other name a sequence folder.",
    )
    format: Format = option(
        Format.ply,
        "ply: the splat file, a 3DGS PLY that also holds the motion. ply-sequence: a static 3DGS PLY for every "
        "timestep. html: one page that plays the run in any browser (docs/web.md). gltf: a .glb with "
        "KHR_gaussian_splatting and an animation. spz: compressed, without motion: the scene at rest or one file for "
        "every timestep of a period. usd: a ParticleField3DGaussianSplat with a sample for every timestep. "
        "docs/export.md compares them.",
    )
    alpha: tuple[float, ...] = option(
        (),
        f"{ALPHA}; with several --band one for each. Not for ply and html, which hold the motion itself. [default: 0]",
    )
    timesteps: list[int] | None = option(
        None,
        "Timesteps to write (sequences, usd). [default: all; spz: one period of the strongest vibration]",
        metavar="A-B,C,…",
        given=str | None,
        into=parse_timesteps,
    )
    low_pass: LowPass = option(
        LowPass.baked,
        "baked: each Gaussian is as wide as training drew it, 0.3 square pixels wider than its scales; for Blender, "
        "and for windows larger than the training pictures. none: scales as trained, for tools that add these 0.3 "
        "square pixels themselves, at the size of the training pictures. linear: scales, opacities and colours fitted "
        "to viewers that blend in linear light, as Blender's own import does; takes minutes, for ply, and spz at rest. "
        "html takes baked only.",
    )

    @property
    def is_at_rest(self) -> bool:
        """Return whether one file without motion is written."""
        return self.format is Format.spz and self.out.suffix.lower() == ".spz"


@dataclass(frozen=True, kw_only=True)
class ProcessOptions(RecordingConfig):
    """Options of the steps of `tg4mm process`, with the same meaning as in their commands."""

    length_file: Path | None = length_file_option()
    sensors: "Sequence[Sensor]" = _sensor_option()
    regions: "Regions | None" = regions_option()
    only: str = option(
        "",
        "Only this region of --regions: it alone is measured, its strongest line magnified in a video of its "
        "surroundings; no pages.",
        metavar="NAME",
    )
    alpha: float | None = option(
        None,
        "Magnification of the video: a displacement δ becomes (1 + alpha) δ. [default: one at which the motion can be "
        "seen]",
    )
    bands: tuple[Band | None, ...] = _one_band_option()
    quick: bool = option(
        False,
        "A coarse first answer: in 3D 1,000 iterations and 10,000 Gaussians; numbers and the video, no pages.",
    )
    all_files: bool = option(
        False,
        "Keep the magnified video's pictures (magnified/), also write plots as SVG, and write the whole scene to "
        "page.html, which otherwise has at most 10 MB.",
    )
    settings: Mapping[str, str] = settings_option(
        "Override one setting, e.g. space.iterations=3000; may be repeated. tg4mm train --list-settings lists them."
    )
    device: Device = device_option()
    threads: int = threads_option()

    @property
    def band(self) -> Band | None:
        """The band that is magnified, Hz; None: the one around the strongest vibration."""
        return self.bands[0] if self.bands else None

    @cached_property
    def sfm(self) -> "SfmConfig":
        """The settings of the reconstruction. Raises Tg4mmError for two lengths."""
        return sfm_config(self, self.length_file)


@dataclass(frozen=True, kw_only=True)
class ProcessCommand(ProcessOptions):
    """Process a video completely: poses, training, numbers, a magnified video and pages.

    Writes OUT/dataset (tg4mm sfm), OUT/run (train), OUT/measured (measure), OUT/magnified.mp4 of the strongest
    vibration (render), OUT/report.html (report) and OUT/page.html (export --format html). Steps that are finished are
    not repeated; a changed option repeats what depends on it, and the earlier folder is kept as run_1.
    """

    source: Path = argument("INPUT", INPUT)
    out: Path = option(REQUIRED, "Folder for everything; an unfinished one is resumed.")
