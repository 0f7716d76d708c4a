"""Damaged and hostile run files: a flipped bit is reported, a wrong type is one line, a kill leaves nothing."""

import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from tests.helpers.runs import SETTINGS, gaussians, modal, refused
from tg4mm.core.errors import RunError
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash, read_tensors, write_tensors


@pytest.fixture
def run(tmp_path):
    (tmp_path / "data").mkdir()
    run = Run.create(tmp_path / "run", tmp_path / "data", "modal", SETTINGS)
    run.save_space(gaussians(), {})
    run.save_motion(modal(), {})
    run.save_part("uncertainty", {"displacement": torch.ones(7)})
    run.save_checkpoint("motion", {"x": torch.arange(300.0)}, {"iteration": 3})
    return run


def anew(run, name, tensors=None, **header):
    """Write a part with other tensors or header entries, its digest right."""
    file = run.part_file(name)
    old, meta = read_tensors(file, name, 1)
    meta = {k: v for k, v in meta.items() if k not in ("format", "digest")} | header
    changed = {**old, **(tensors or {})}
    write_tensors(file, {k: v for k, v in changed.items() if v is not None}, meta)


def without_digest(file):
    """Tensors and header of a file as it was written before there were digests."""
    with safe_open(file, framework="pt") as opened:
        meta = {k: v for k, v in opened.metadata().items() if k != "digest"}
        return {name: opened.get_tensor(name) for name in opened.keys()}, meta  # noqa: SIM118


def _read(read):
    """What is read, as text; None for a refusal."""
    try:
        return repr(read())
    except RunError:
        return None


@pytest.mark.parametrize("name", ["space", "motion", "uncertainty", "checkpoint_motion"])
def test_a_flipped_bit_is_reported_or_does_no_harm(run, name):
    """Never a number that is not what was written. Most bits lie in numbers."""
    reads: dict[str, Callable[[], Any]] = {
        "space": run.load_space, "motion": run.load_motion, "uncertainty": run.load_uncertainty,
        "checkpoint_motion": lambda: run.load_checkpoint("motion"),
    }  # fmt: skip
    file = run.part_file(name)
    whole, expected, rng, refused = file.read_bytes(), repr(reads[name]()), random.Random(0), 0
    for _ in range(300):
        raw = bytearray(whole)
        raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        file.write_bytes(raw)
        found = _read(reads[name])
        assert found in (expected, None)
        refused += found is None
    assert refused > 250


def test_damage_to_a_number_is_called_so_and_a_checkpoint_says_what_to_do(run):
    file = run.part_file("checkpoint_motion")
    raw = bytearray(file.read_bytes())
    raw[-5] ^= 0x40  # an exponent: 299 becomes 1e21
    file.write_bytes(raw)
    said = "is damaged or edited: its content is not what was written; delete it to start the motion stage"
    with refused(said):
        run.load_checkpoint("motion")


def test_results_from_before_digests_are_still_read(run):
    file = run.part_file("motion")
    before = model_hash(run.path)
    tensors, meta = without_digest(file)
    save_file(tensors, file, metadata=meta)
    motion = run.load_motion()
    np.testing.assert_array_equal(motion.displacement, modal().displacement)
    assert model_hash(run.path) == before


@pytest.mark.parametrize(
    ("key", "text", "match"),
    [
        ("fps", "0", "fps is 0, expected a finite number above 0"),
        ("fps", '"30"', "fps is '30'"),
        ("n_timesteps", "1000000000", "n_timesteps is 1000000000, expected .* above 0 and of at most 1e"),
        ("n_timesteps", "2.5", "n_timesteps is 2.5, expected a whole number"),
        *(  # JSON has none of them, Python reads them
            (key, text, f"{key} is (nan|inf|-inf), expected a finite number above 0")
            for key in ("fps", "n_timesteps")
            for text in ("NaN", "Infinity", "-Infinity", "1e999")
        ),
    ],
)
def test_a_clock_that_cannot_be_is_refused(run, key, text, match):
    file = run.part_file("motion")
    tensors, meta = without_digest(file)
    save_file(tensors, file, metadata=meta | {key: text})
    with refused(match):
        run.load_motion()


@pytest.mark.parametrize(
    ("key", "value"),
    [("reliability", [None]), ("reliability", 1), ("duration_s", "x"), ("duration_s", 1e30), ("readout_s", None),
     ("nuisance", True), ("frequencies_hz", None), ("notes", 0), ("notes", [1]), ("clip_phases_deg", {"a": {"x": 1}})],
)  # fmt: skip
def test_a_row_of_the_log_that_something_is_computed_from_is_checked(run, key, value):
    (run.path / "log.json").write_text(json.dumps({"motion": {key: value}}))
    with refused(key):
        run.log()


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ([1], "settings of motion is .1., expected an object"),
        ({"brand_new": 3}, "motion.brand_new is a setting that this version of tg4mm does not have"),
        ({"components": "x"}, "motion.components is 'x', expected a whole number"),
    ],
)
def test_settings_of_another_version_are_named(run, settings, match):
    other = run.path.with_name("other")
    with refused(match):
        made = Run.create(other, run.dataset, "modal", {"motion": settings})
        made.save_space(gaussians(), {})
        made.save_motion(modal(), {})
        Run.open(other).load_fit()


@pytest.mark.parametrize(
    ("name", "tensors", "match"),
    [
        ("space", {"means": torch.ones(7, 3, dtype=torch.int32)}, "means is torch.int32, expected torch.float32"),
        ("space", {"means": torch.ones(7, 3, dtype=torch.float64)}, "means is torch.float64"),
        ("space", {"means": torch.ones(())}, "space.safetensors: "),
        ("space", {"sh": None}, "holds the tensors"),
        ("space", {"scales": -torch.ones(7, 3)}, "scales reach down to -1, expected at least 0"),
        ("space", {"opacities": torch.full((7,), 1.5)}, "opacities span 1.5 to 1.5, expected 0 to 1"),
        ("motion", {"displacement": torch.ones(2, 7, 3)}, "displacement is torch.float32, expected torch.complex64"),
        ("motion", {"rotation": None}, "holds the tensors"),
        ("motion", {"freqs_hz": torch.tensor([-1.0, 2.0]).double()}, "freqs_hz is .*none below 0"),
        ("motion", {"freqs_hz": torch.ones(2, 1).double()}, "freqs_hz is .*expected a list"),
        ("uncertainty", {"displacement": None, "other": torch.ones(7)}, "displacement is absent, expected float32"),
        ("uncertainty", {"displacement": torch.ones(6)}, r"is torch.float32 \(6,\), expected float32 \(7,\)"),
        ("uncertainty", {"displacement": torch.ones(7, dtype=torch.int64)}, "expected floating-point numbers"),
        ("uncertainty", {"displacement": -torch.ones(7)}, "displacement holds -1, expected at least 0"),
        ("uncertainty", {"noise": torch.ones(3)}, r"noise is torch.float32 \(3,\), expected float32 \(7,\)"),
        ("uncertainty", {"covariance": torch.ones(7, 3)}, r"covariance is .*expected float32 \(7, 3, 3\)"),
    ],
)  # fmt: skip
def test_tensors_of_another_kind_are_refused(run, name, tensors, match):
    anew(run, name, tensors)
    read = {"space": run.load_space, "motion": run.load_motion, "uncertainty": run.load_uncertainty}[name]
    with refused(match):
        read()


@pytest.mark.parametrize(
    ("log", "match"),
    [
        ({"space": 3}, "space is 3, expected an object"),
        ({"space": {"seconds": "1"}}, "space.seconds is '1', expected a finite number of at least 0"),
        ({"space": {"peak_memory_mib": [1]}}, r"space.peak_memory_mib is \[1\]"),
        ({"space": {"seconds": float("nan")}}, "holds nan, which is no finite number"),
        ([], "holds list, expected an object"),
    ],
)
def test_a_log_of_another_form_is_refused(run, log, match):
    (run.path / "log.json").write_text(json.dumps(log))
    with refused(match):
        run.log()
    with refused(match):
        run.record("space", {"seconds": 1.0})


def test_a_checkpoint_that_a_kill_left_beside_its_result_is_forgotten(run, tmp_path):
    """The kill came between the rename of motion.safetensors and the removal."""
    run.save_checkpoint("triplane", {"x": torch.ones(1)}, {})
    Run.create(run.path, tmp_path / "data", "modal", SETTINGS)
    kept = sorted(p.name for p in run.path.glob("checkpoint_*"))
    assert kept == ["checkpoint_triplane.safetensors"]  # whose result is not there
