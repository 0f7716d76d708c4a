"""A small random scene as parameters of the space stage, with cameras and pictures."""

import numpy as np
from torch import Tensor

from tests.fit.rasterize.oracle import Scene, make_scene
from tg4mm.fit.space.targets import RestViews

SCENE = make_scene(0, n=300, cameras=3)


def parameters(scene: Scene = SCENE) -> dict[str, Tensor]:
    p = [t.detach().float() for t in (scene.means, scene.quats, scene.scales, scene.opacities, scene.colors)]
    return {
        "means": p[0],
        "quats": p[1],
        "log_scales": p[2].log(),
        "logits": p[3].clamp(0.01, 0.99).logit(),
        "sh0": p[4][:, :1],
        "shn": p[4][:, 1:],
    }


def views_of(scene: Scene = SCENE) -> RestViews:
    """The scene's cameras and random pictures."""
    shape = (len(scene.viewmats), scene.height, scene.width)
    rng = np.random.default_rng(0)
    return RestViews(
        scene.viewmats.float().numpy(), scene.Ks.float().numpy(), rng.uniform(size=(*shape, 3)).astype(np.float32),
        np.ones(shape, np.float32), tuple(np.array([v]) for v in range(shape[0])),
    )  # fmt: skip
