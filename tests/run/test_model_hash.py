"""The digest of a model follows what it has learned, not how its files were written."""

import json

import numpy as np
import torch
from safetensors.torch import load_file, safe_open

from tests.helpers.runs import SETTINGS, gaussians, modal
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash


def written(folder, settings=SETTINGS, scale=1.0, fps=30.0):
    run = Run.create(folder, folder.parent, "modal", settings)
    run.save_space(gaussians(), {"seconds": 1.0})
    motion = modal()
    motion = type(motion)(motion.freqs_hz, motion.displacement * np.float32(scale), motion.rotation, fps, 30)
    run.save_motion(motion, {})
    return run.path


def reordered(file):
    """The same file as another writer may make it: keys of the header in another order."""
    with safe_open(file, framework="pt") as opened:
        meta = opened.metadata()
    data = file.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    turned = dict(reversed(header.items())) | {"__metadata__": dict(sorted(meta.items(), reverse=True))}
    text = json.dumps(turned).encode()
    text += b" " * (-len(text) % 8)
    file.unlink()  # tensors read before are maps of it
    file.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])


def test_equal_models_in_other_folders_with_other_settings_have_one_digest(tmp_path):
    a, b = written(tmp_path / "a"), written(tmp_path / "b", {"seed": 5})
    assert model_hash(a) == model_hash(b)


def test_the_order_of_a_files_header_does_not_matter(tmp_path):
    run = written(tmp_path / "run")
    before, tensors = model_hash(run), load_file(run / "space.safetensors")
    bytes_before = (run / "space.safetensors").read_bytes()
    reordered(run / "space.safetensors")
    assert (run / "space.safetensors").read_bytes() != bytes_before
    assert all(torch.equal(v, tensors[k]) for k, v in load_file(run / "space.safetensors").items())
    assert model_hash(run) == before


def test_another_value_another_frame_rate_and_a_missing_motion_give_other_digests(tmp_path):
    variants = [
        written(tmp_path / "a"),
        written(tmp_path / "b", scale=1.5),
        written(tmp_path / "c", fps=25.0),
    ]
    digests = {model_hash(run) for run in variants}
    (variants[0] / "motion.safetensors").unlink()
    assert len(digests | {model_hash(variants[0])}) == 4
