"""Readers of what tg4mm keeps for itself: scores, records of renderings, benchmarks, caches."""

import math
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

from tests.faults.mutate import of_bytes, of_json, of_sealed, of_tensors, of_text
from tests.faults.reader import Reader, T, paper_run, reading, record, run_of, sample, sealed
from tests.show.measure import filmed
from tests.show.measure.filmed import modes, of_parts, sine
from tg4mm.core.errors import RunError
from tg4mm.core.files import json_digest
from tg4mm.core.magnification import BandGain, Magnification
from tg4mm.research.bench import jobs
from tg4mm.research.bench.folder import open_folder
from tg4mm.research.bench.jobs import _Kept
from tg4mm.research.bench.means import group_means, line_means
from tg4mm.research.bench.measure import VERSION, read_figures
from tg4mm.research.bench.pages.tables import cost_table, modes_table, motion_table, own_ceiling_table, pivots
from tg4mm.research.bench.scored import with_closure
from tg4mm.research.evaluate.run import _is_ours
from tg4mm.research.paper import preset
from tg4mm.research.paper.model import load_model, save_planes
from tg4mm.research.paper.preset import series_of
from tg4mm.run import Run, log
from tg4mm.show.analyse import lines_of, read_channels
from tg4mm.show.measure import prepare, prepared
from tg4mm.show.measure.measurement import measure_one
from tg4mm.show.measure.sensors import Sensor
from tg4mm.show.render import sequence
from tg4mm.show.render.cameras import Camera
from tg4mm.show.render.sequence import RenderRequest, work_folder
from tg4mm.show.report import closing, summary

ROW = {"psnr_db": 31.25, "ssim": 0.91, "flip": 0.05, "lpips": None}
FREQUENCY = {
    "frequency_hz": 5.0, "amplitude_true": 0.02, "amplitude_estimated": 0.018, "amplitude_ratio": 0.9,
    "relative_error": 0.1, "phase_error_deg": -1.5, "direction_error_deg": None, "mac": 0.99,
}  # fmt: skip
DISPLACEMENT = {
    "relative_error": 0.1, "rms_error": 0.001, "rms_true": 0.01, "rms_estimated": 0.009, "static_leak": None,
    "static_share": 0.5, "per_frequency": [FREQUENCY], "in_band": {"relative_error": 0.1},
    "uncertainty": {"said": 0.001, "error": 0.001, "within_two": 0.95},
}  # fmt: skip
ROWS = dict.fromkeys(("nothing moves", "ours", "ceiling"), ROW)
METRICS = {
    "format": "tg4mm-metrics", "version": 1, "metrics": ["psnr_db", "ssim"],
    "alphas": [{"alpha": alpha, "n_images": 6, "rows": ROWS, "closure": 0.75} for alpha in (0, 5)],
    "displacement": DISPLACEMENT, "absent": {"LPIPS": "no weights"}, "notes": ["a note"],
}  # fmt: skip
OF_RUN: dict[str, Any] = {
    "log": {"space": {"seconds": 2.5, "init": "points", "peak_memory_mib": 100.0, "iterations": 30},
            "motion": {"seconds": 1.5}},
    "seconds": {"space": 2.5, "motion": 1.5, "total": 4.0}, "model": "ab" * 32,
    "rows": {alpha: dict.fromkeys(("nothing moves", "modal", "ceiling"), ROW) for alpha in ("0", "5", "20")},
    "displacement": DISPLACEMENT, "notes": ["a note"],
}  # fmt: skip
FIGURES = {
    "version": VERSION, "request": {"settings": {"space": {"seed": 0}}, "band_hz": [3.5, 6.5]}, **OF_RUN,
    "n_gaussians": 300, "mib_on_disk": 1.5, "absent": {"LPIPS": "no weights"},
    "observed": {"displacement_error_observed": 0.1, "observed_share": 0.5}, "strongest_hz": 5.01,
}  # fmt: skip
RENDERED = {"recipe": json_digest({"data": "a", "alpha": 20})[:20], "n_images": 6, "frames_per_s": 31.5}
BENCH = {"format": "tg4mm-bench", "version": 1, "kind": "scenes"}

_LINE = [[math.sin(k), None] for k in range(20)]
_PEAK = {
    "frequency_hz": 3.0, "frequency_deviation_hz": 0.1, "main_amplitude": 0.1, "main_deviation": 0.01,
    "main_is_above": True, "damping_ratio": 0.02, "damping_deviation": None,
}  # fmt: skip
_SERIES = {
    "clock": "", "axes": {"right": [1, 0, 0], "sight": [0, 0, 1]}, "times_s": [k / 20 for k in range(20)],
    "displacement": _LINE, "noise": [0.1, None], "model_share": [0.1, 0.1],
}  # fmt: skip
_SENSOR = {"name": "tip", "px_per_unit": 50.0, "series": [_SERIES], "peaks": [_PEAK]}
_MEASURED = {"printed_unit": "mm", "unit_scale_m": 0.1, "sensors": [_SENSOR]}
_CSV = "time_s,tip_mm,tip_mm_deviation\n" + "".join(f"{k / 20},{math.sin(k)},0.1\n" for k in range(20))


def _read_metrics(root):
    """All that the report does with them."""
    _is_ours(root / "metrics.json")
    found: Any = SimpleNamespace(
        metrics=log.read_figures(root / "metrics.json"), model=SimpleNamespace(motion=None),
        train=SimpleNamespace(unit_scale_m=0.1, scene={}), view=SimpleNamespace(alpha=5.0, truth=None),
    )  # fmt: skip
    closing.accuracy_section(found)
    summary._ssim_stat(found)
    summary._error_stat(found)


# Benchmarks.


def _read_figures(root):
    found = read_figures(root)
    if found is None:
        raise RunError("it is made anew")
    run = {k: v for k, v in found.items() if k not in {"version", "request"}}
    run |= {"set": "a", "row": "modal", "preset": "modal", "ways": ["modal"], "overrides": {}}
    results: dict[str, Any] = {"sets": [{"label": "a", "group": "g"}], "runs": [run], "lines": []}
    results["means"] = group_means([run], {"a": "g"})
    for table in (motion_table, modes_table, cost_table, own_ceiling_table):
        table(results, "g")


def _read_scores(root):
    found = [entry["scores"] for entry in _Kept(root / "scores.json").entries.values()]
    if not found:
        raise RunError("it is made anew")
    names = ["nothing moves", "ceiling", *map(str, range(len(found)))]
    with_closure(dict(zip(names, found, strict=False)), "nothing moves", "ceiling")
    lines = [
        {"set": "a", "row": str(i), "alphas": {"5": s}, "frames_per_s": None} for i, s in enumerate(found)
    ]
    list(pivots(line_means(lines, {"a": "g"}), "g"))


def _read_rendered(root):
    """Not what is rendered where it is of no use."""

    def render(*_):
        raise RunError("it is made anew")

    method: Any = SimpleNamespace(recipe=lambda *_: {}, render=render)
    data, capture = SimpleNamespace(digest="a"), [0]
    with patch.object(jobs, "truth_at", lambda *_: []):  # no picture is looked for
        found = jobs.rendered(method, "ours", data, root, capture, 20, None)
    np.median([found["frames_per_s"] or 0.0])


def _read_bench(root):
    open_folder(root / "out", "scenes")


# Runs.


def _render_record(root):
    _claim(root, make=True)
    return root / "out" / "render.json"


def _claim(root, make=False):
    if make:
        run_of("config.json")(root)
    camera = Camera("r_000", np.eye(4), np.eye(3), 12, 8)
    work_folder(root / "out").claim(
        sequence.record(Run.open(root / "run"), RenderRequest(Magnification.of(5.0)), [camera], "sequence")
    )


def _embeddings(name):
    def make(root):
        _make_embeddings(root)
        (file,) = (root / "run" / "magnified").glob(f"*.{name}")
        return file

    return make


def _plan():
    return Magnification((BandGain(4, 6, 5.0),), method="linear")


def _make_embeddings(root):
    paper_run("config.json")(root)
    run = Run.open(root / "run")
    cells = len(load_model(run).cells)
    for t in range(1, T):
        save_planes(run, t, torch.zeros(cells, 2))
    series_of(run, "linear", _plan())


def _read_embeddings(root):
    """Not what is made where they are of no use, which would write."""

    def anew(*_):
        raise RunError("they are made anew")

    with patch.object(preset, "_make", anew):
        preset.series_of(Run.open(root / "run"), "linear", _plan()).at(0.5)


def _pass(root):
    prepare(
        filmed.run_of(root, of_parts(ball=sine(5.0, [0.01, 0, 0])), modes({}, 6), n_timesteps=6, n_views=2)
    )
    return root / "run" / "residuals.safetensors"


def _read_pass(root):
    """Not the pictures where it is of no use."""

    def anew(*_):
        raise RunError("the pictures are read again")

    with patch.object(prepared, "_looked", anew):
        measure_one(prepare(Run.open(root / "run"), keep=False), Sensor("all", "all", ()))


RESULTS: dict[str, Reader] = {
    "analyse CSV": Reader(sample("a.csv", _CSV), reading("a.csv", read_channels), of_text),
    "analyse measure.json": Reader(record("measure.json", _MEASURED), lines_of, of_json),
    "metrics.json": Reader(sealed("metrics.json", METRICS), _read_metrics, of_sealed),
    "render.json": Reader(_render_record, _claim, of_json),
    "magnified, record": Reader(_embeddings("json"), _read_embeddings, of_json),
    "magnified, embeddings": Reader(_embeddings("f32"), _read_embeddings, of_bytes),
    "measure's kept pass": Reader(_pass, _read_pass, of_tensors),
    "bench figures.json": Reader(sealed("figures.json", FIGURES), _read_figures, of_sealed),
    "bench scores.json": Reader(
        sealed("scores.json", {"version": 1, "entries": {f"a {i}": {"asked": "x", "scores": ROW} for i in range(3)}}),
        _read_scores, of_sealed,
    ),
    "bench x020.json": Reader(sealed("pictures/ours/x020.json", RENDERED), _read_rendered, of_sealed),
    "bench bench.json": Reader(record("out/bench.json", BENCH), _read_bench, of_json),
}  # fmt: skip
