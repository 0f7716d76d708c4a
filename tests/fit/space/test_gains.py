"""Gains of pictures: what fits is found, ratios alone count, and pictures spoilt by known gains give these back."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tg4mm.fit.space import SpaceConfig
from tg4mm.run.stages.space import train_space
from tg4mm.show.render.image import render_image


def test_known_gains_are_found(views, points, new_run):
    """A quarter at most of 10 % is left, and the Gaussians are nearer to the pictures without gains.

    After 1500 iterations .17 or .27 is left by the order of sums alone, after 2500 .19 to .21.
    """
    logs = np.random.default_rng(0).normal(0, 0.1, (len(views.rgb), 3))
    given = np.exp(logs - logs.mean(0))
    # a grey floor in place of white, which would be clipped
    clean = 0.7 * views.rgb
    spoilt = replace(views, rgb=(clean * given[:, None, None]).astype(np.float32))
    error = {}
    for gains in (True, False):
        run = new_run()
        config = SpaceConfig(iterations=2500, max_gaussians=1500, gains=gains)
        gaussians = train_space(run, spoilt, points, config)
        cameras = zip(views.viewmats, views.Ks, strict=True)
        pictures = np.stack([render_image(gaussians, m, K, *views.size) for m, K in cameras])
        error[gains] = float(np.sqrt(np.mean((pictures - clean) ** 2)))
        assert ("gains" in run.log()["space"]) == gains
        if gains:
            off = np.log(run.log()["space"]["gains"]) - np.log(given)
            assert off.std() < 0.25 * np.log(given).std()
    assert error[True] < error[False]


@pytest.mark.parametrize("gains", [True, False])
def test_torch_and_the_fused_iteration_agree_on_gains(gains):
    from tests.helpers.space_fused import SCENE, parameters, views_of
    from tests.helpers.space_parameters import EXTENT
    from tg4mm.fit.space import train as stage
    from tg4mm.fit.space.fused import FusedAdam
    from tg4mm.fit.space.parameters import ParameterAdam

    start = torch.tensor([[0.8, 1.0, 1.2], [1.0, 1.1, 1.0], [1.25, 1 / 1.1, 1 / 1.2]])
    found = []
    for kind in (FusedAdam, ParameterAdam):
        cameras = stage._Views(views_of(), SpaceConfig(dssim=0.2), "cpu")
        generator, error = torch.Generator(), torch.zeros(len(SCENE.means))
        fit = stage._Fit(kind(parameters(), EXTENT), error, torch.zeros(()), generator, generator)
        fit.gains = start if gains else None
        cameras.iterate(fit, 0, 3, 0.0)
        found.append((fit.adam.moments()["sh0.m"], fit.gains))
    torch.testing.assert_close(found[0][0], found[1][0], rtol=1e-3, atol=1e-6)
    if gains:
        torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-5, atol=1e-6)
        assert not torch.equal(found[0][1], start)
