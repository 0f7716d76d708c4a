"""Every reader of files that may come from elsewhere: a valid sample, how to read it, how to mutate it.

All of them may raise Tg4mmError, with one line, and nothing else. Files that Blender's own importers read (.blend, .glb
and the like) are not among them: they are read in a process of their own, by code that is not ours.
"""

import io
from pathlib import Path
from unittest.mock import patch

import numpy as np
import tifffile
import torch
import yaml
from PIL import Image
from safetensors.torch import save_file

from dataset_gen.farm import sets
from dataset_gen.sources import bodies_file
from dataset_gen.tree import work_folder
from dataset_gen.vibration import read_motion
from tests.capture.sfm.test_recording_files import tone, write_cine, write_photron
from tests.capture.sfm.videos import still, write_video
from tests.faults.mutate import of_bytes, of_header, of_json, of_npz, of_png, of_tensors, of_text
from tests.faults.reader import Reader, T, gaussians, motion, paper_run, reading, record, run_of, sample
from tests.faults.readers_captures import CAPTURES
from tests.faults.readers_datasets import DATASETS
from tests.faults.readers_results import RESULTS
from tests.faults.readers_splats import SPLATS
from tests.helpers.bodies_file import FOUND
from tg4mm.capture.sfm.clip import WHOLE, Clip, Sources
from tg4mm.capture.sfm.config import open_request
from tg4mm.capture.sfm.defects import is_fixed, stretches_of
from tg4mm.capture.sfm.scale import checked_length, read_length
from tg4mm.capture.sfm.staging import exif_turns
from tg4mm.capture.sfm.survey import survey_clip
from tg4mm.capture.video import video_frames, video_info
from tg4mm.core.pictures.decode import decode, read_png
from tg4mm.core.splatfile import SplatFile, read_splat, write_splat
from tg4mm.core.work_folder import WorkFolder, run_steps
from tg4mm.research.demo import STEPS_FILE
from tg4mm.research.evaluate.lpips import _read
from tg4mm.research.paper.model import load_model, load_planes, plane_video
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.analyse import read_channels
from tg4mm.show.measure.sensors import read_sensors
from tg4mm.show.report.closing import _stage
from tg4mm.show.report.summary import total_seconds

MOTION = (Path(__file__).parents[2] / "dataset_gen" / "scenes" / "ship.yaml").read_text()
CLAIM = {"fps": 30, "modes": [{"a": 1}], "cameras": {"n": 3}}

FARM = {
    "python": "python",
    "out": "sets",
    "threads": 2,
    "options": "--size 32",
    "scenes": {"mic": "--seed 1"},
}
LENGTH = {"metres": 0.5, "points": [{"a": [1, 2], "b": [3, 4]}, {"a": [5, 6.5], "b": [7, 8]}]}
SURVEY = {
    "width": 12, "height": 8, "fps": "30000/1001", "times": ["0", "1/30", "2/30"],
    "shifts_px": [[0, 0], [0.5, None], [1, 1]], "parts": [0, 0, -1], "frozen": [False, False, True],
    "sharpness": [1.0, 2.0, 3.0], "together": [1.0, None, 0.5], "repeats": [], "share": "5/6", "kinds": "IBP",
    "created_s": 1.5,
}  # fmt: skip
SENSORS = "sensors:\n- {name: tip, sphere: [0, 0, 1.2, 0.1]}\n- {name: wall, pixel: [cam, 32, 9, 12]}\n"
_ROWS = "".join(f"{k / 20:.2f};{k % 3}\n" for k in range(40)).replace(".", ",")
STATE = {"features.0.bias": torch.ones(64), "lin0.model.1.weight": torch.ones(1, 64, 1, 1)}


def _splat(root):
    g, m = gaussians(), motion()
    arrays = [getattr(g, k).numpy() for k in ("means", "quats", "scales", "opacities", "sh")]
    splat = SplatFile(*arrays, m.freqs_hz, m.displacement, m.rotation, 30.0, T, 0.01)
    write_splat(root / "a.ply", splat)
    return root / "a.ply"


def _read_run(root):
    """All that render, export and report read."""
    run = Run.open(root / "run")
    run.load_space()
    run.load_motion()
    run.load_uncertainty()
    run.load_checkpoint("space")
    run.load_fit()
    total_seconds(run.log())
    for name, figures in run.log().items():
        _stage(name, figures)
    model_hash(run.path)


def _resume_run(root):
    run = Run.create(root / "run", root / "data", "modal", {"space": {"seed": 0, "l2": 0.5}})
    run.record("space", {"seconds": 1.0, "peak_memory_mib": 5.0})


def _read_paper(root):
    run = Run.open(root / "run")
    model = load_model(run)
    model.decode(model.embedding(load_planes(run, 1, model)))
    plane_video(run, model, 2, 0, 1)


def _read_demo(root):
    folder = WorkFolder(root, STEPS_FILE, free=("done",))
    request = {"format": "tg4mm-demo", "version": 1, "size": 64}
    folder.claim(request, {**request, "done": {}})
    run_steps(folder, request, [], print)


# The generator, and reconstruction.


def _claim(root):
    work_folder(root / "set").claim(CLAIM)


def _farm(root):
    text = (root / "config.json").read_text(encoding="utf-8", errors="replace")
    with patch.multiple("sys", stdin=io.StringIO(text), stdout=io.StringIO(), stderr=io.StringIO()):
        assert sets.main() in (0, 2)


def _read_survey(root):
    found = survey_clip(Clip("a", root / "a.mp4"), root / "survey", WHOLE)
    found.clock()
    is_fixed(found)
    stretches_of(found, fixed=True)


def _request(root):
    return open_request(root / "out", Sources(root), {"kind": "rig", "fps": None}).folder / "request.json"


def _read_request(root):
    open_request(root / "out", Sources(root), {"kind": "rig", "fps": None}).finished()


def _finished(root):
    _request(root)
    return record("out/scene.json", {"fps": 30, "sfm": {"asked": {"kind": "rig"}, "points": 3}})(root)


def _video(file):
    write_video(file, still(4, size=(32, 24)))


def _read_video(root):
    video_info(root / "a.mp4")
    for _ in video_frames(root / "a.mp4"):
        pass


def _stack(name):
    def make(root):
        frames = tone(3)[:, :24, :32]
        if name == "a.cine":
            return write_cine(root / name, frames, 240)
        if name == "a.tif":
            tifffile.imwrite(root / name, frames, photometric="minisblack")
            return root / name
        return write_photron(root / name, frames, 240, 12, xml=name == "a.cihx")

    return make


def _read_stack(root):
    path = next(p for p in root.iterdir() if p.suffix in (".cine", ".tif", ".cih", ".cihx"))
    video_info(path)
    for _ in video_frames(path):
        pass


def _photograph(suffix):
    def write(file):
        exif = Image.Exif()
        exif[0x0112] = 6  # a quarter turn
        Image.fromarray(np.random.default_rng(0).integers(0, 256, (8, 12, 3), np.uint8)).save(file, exif=exif)

    return sample(f"a{suffix}", write)


def _universal():
    """Datasets 164 and 58, by hand."""
    head = [
        "tip", "NONE", "NONE", "NONE", "NONE",
        "    1         0    0         0       NONE         3   1       NONE         0   0",
        "         4        40         1  0.00000e+00  9.76562e-04  0.00000e+00",
        "        17    0    0    0 NONE                 s",
        *(f"{kind:10d}    0    0    0 NONE                 NONE" for kind in (8, 0, 0)),
    ]  # fmt: skip
    values = ["".join(f"{(4 * k + j) % 7:20.11e}" for j in range(4)) for k in range(10)]
    units = ["         1SI units                      1", f"{1000:25.17E}{1:25.17E}{1:25.17E}", f"{0:25.17E}"]
    kinds = ((164, units), (58, head + values))
    return "".join("\n".join(["    -1", f"{n:6d}", *lines, "    -1\n"]) for n, lines in kinds)


def _save_weights(file):
    save_file(STATE, file, metadata={"kind": "1", "version": "1"})


_read_motion = reading("motion.*", lambda file: read_motion(file).to_json())
_read_length = reading("length.*", lambda file: checked_length(read_length(file)))

READERS: dict[str, Reader] = {
    "splat file": Reader(_splat, reading("a.ply", read_splat), of_header),
    "run config.json": Reader(run_of("config.json"), _read_run, of_json),
    "run config.json, resumed": Reader(run_of("config.json"), _resume_run, of_json),
    "run log.json": Reader(run_of("log.json"), _read_run, of_json),
    "run log.json, resumed": Reader(run_of("log.json"), _resume_run, of_json),
    "run space": Reader(run_of("space.safetensors"), _read_run, of_tensors),
    "run motion": Reader(run_of("motion.safetensors"), _read_run, of_tensors),
    "run uncertainty": Reader(run_of("uncertainty.safetensors"), _read_run, of_tensors),
    "run checkpoint": Reader(run_of("checkpoint_space.safetensors"), _read_run, of_tensors),
    "run triplane": Reader(paper_run("triplane.safetensors"), _read_paper, of_tensors),
    "run planes": Reader(paper_run("planes_0001.safetensors"), _read_paper, of_tensors),
    "table": Reader(
        sample("a.csv", f"# logger\ntime [s];acc [g]\n{_ROWS}"), reading("a.csv", read_channels), of_text
    ),
    "universal file": Reader(sample("a.uff", _universal()), reading("a.uff", read_channels), of_text),
    "demo.json": Reader(
        record("demo.json", {"format": "tg4mm-demo", "version": 1, "size": 64, "done": {"train": 1.5}}),
        _read_demo,
        of_json,
    ),
    "LPIPS weights, safetensors": Reader(
        sample("w.safetensors", _save_weights), reading("w.*", _read), of_tensors
    ),
    "LPIPS weights, pth": Reader(
        sample("w.pth", lambda file: torch.save(STATE, file)), reading("w.*", _read), of_bytes
    ),
    "motion YAML": Reader(sample("motion.yaml", MOTION), _read_motion, of_text),
    "motion JSON": Reader(record("motion.json", yaml.safe_load(MOTION)), _read_motion, of_json),
    "bodies npz": Reader(
        sample("found.npz", lambda file: bodies_file.save(file, FOUND)),
        reading("found.npz", bodies_file.load),
        of_npz,
    ),
    "generate: scene.json": Reader(record("set/scene.json", CLAIM), _claim, of_json),
    "farm configuration": Reader(record("config.json", FARM), _farm, of_json),
    "sfm length.json": Reader(record("length.json", LENGTH), _read_length, of_json),
    "sfm length.yaml": Reader(sample("length.yaml", yaml.safe_dump(LENGTH)), _read_length, of_text),
    "sfm survey": Reader(record("survey/a.json", SURVEY), _read_survey, of_json),
    "sfm request.json": Reader(_request, _read_request, of_json),
    "sfm scene.json": Reader(_finished, _read_request, of_json),
    "sfm photograph, PNG": Reader(_photograph(".png"), reading("a.*", exif_turns), of_png),
    "sfm photograph, JPEG with EXIF": Reader(_photograph(".jpg"), reading("a.*", exif_turns), of_bytes),
    "rendered picture": Reader(_photograph(".png"), reading("a.png", read_png), of_png),
    "sensors YAML": Reader(sample("sensors.yaml", SENSORS), reading("sensors.yaml", read_sensors), of_text),
    "sfm photograph, WebP": Reader(_photograph(".webp"), reading("a.*", decode), of_bytes),
    "sfm photograph, TIFF": Reader(_photograph(".tif"), reading("a.*", decode), of_bytes),
    "sfm video": Reader(
        sample("a.mp4", lambda file: write_video(file, still(4, size=(32, 24)))), _read_video, of_bytes
    ),
    "TIFF of pages": Reader(_stack("a.tif"), _read_stack, of_bytes),
    "Phantom cine": Reader(_stack("a.cine"), _read_stack, of_bytes),
    "Photron cih": Reader(_stack("a.cih"), _read_stack, of_text),
    "Photron cihx": Reader(_stack("a.cihx"), _read_stack, of_text),
    **CAPTURES,
    **SPLATS,
    **DATASETS,
    **RESULTS,
}
