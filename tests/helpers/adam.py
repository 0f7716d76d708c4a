"""Two runs of Adam that should differ in rounding alone, compared by what does not hang on rounding.

Adam divides a gradient's mean by its root mean square. Where a gradient is zero but for rounding, as that of a disk's
turn about its own axis, the order of sums decides whether a parameter goes a whole rate up or down. So gradients are
compared everywhere, and parameters where every step so far had a root mean square well above rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.fit.rasterize.oracle import assert_close
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.space import train as space_stage
from tg4mm.research.paper.space import Fit

FIRST = 1e-4  # of the largest gradient, at the first step
LATER = 1e-3  # the same at later steps, whose parameters have gone apart already
MOVED = 1e-2  # of the largest change of a parameter
# Rounding of a gradient is up to 3e-5 of its tensor's largest entry: 3e-3 of an entry of this share of it.
FLOOR = 1e-2
LEAST = 0.05  # of a tensor's entries must be compared: a comparison of nothing would hold


@dataclass
class Steps:
    """What each step left, by parameter; tensors stay on their device, so that nothing crosses for being watched."""

    start: dict[str, Tensor]
    end: dict[str, Tensor] = field(default_factory=dict)
    means: list[dict[str, Tensor]] = field(default_factory=list)  # Adam's, of the gradient
    squares: list[dict[str, Tensor]] = field(default_factory=list)  # and of its square

    def add(self, parameters: Mapping[str, Tensor], moments: Mapping[str, Tensor]) -> None:
        """The state after a step; moments are called `<name>.m` and `<name>.v`."""
        self.end = copied(parameters)
        self.means.append({name: moments[f"{name}.m"].clone() for name in parameters})
        self.squares.append({name: moments[f"{name}.v"].clone() for name in parameters})


def copied(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: p.detach().clone() for name, p in parameters.items()}


def watch_paper(monkeypatch: pytest.MonkeyPatch) -> list[Steps]:
    """The steps of each `Fit` that is made from now on, in the order of their making."""
    watched: list[Steps] = []
    start, step = Fit.__init__, Fit.step

    def started(fit: Fit, *arguments: Any) -> None:
        start(fit, *arguments)
        watched.append(Steps(copied(fit.parameters)))

    def stepped(fit: Fit, loss: Tensor) -> None:
        step(fit, loss)
        tensors = fit.tensors()  # m.<name>, v.<name>
        watched[-1].add(fit.parameters, {f"{k[2:]}.{k[0]}": v for k, v in tensors.items() if k[1] == "."})

    monkeypatch.setattr(Fit, "__init__", started)
    monkeypatch.setattr(Fit, "step", stepped)
    return watched


def watch_space(monkeypatch: pytest.MonkeyPatch) -> list[Steps]:
    """The steps of each space stage that is run from now on. Its Gaussians start `oblong`."""
    watched: list[Steps] = []
    iterate, initial = space_stage._iterate, space_stage.initial_parameters

    def iterated(fit: Any, *arguments: Any) -> None:
        if fit.iteration == 0:
            watched.append(Steps(copied(fit.adam.parameters)))
        iterate(fit, *arguments)
        watched[-1].add(fit.adam.parameters, fit.adam.moments())

    def started(*arguments: Any) -> dict[str, Tensor]:
        made = initial(*arguments)
        return made | {"log_scales": made["log_scales"] + _stretches(made["log_scales"].shape)}

    monkeypatch.setattr(space_stage, "_iterate", iterated)
    monkeypatch.setattr(space_stage, "initial_parameters", started)
    return watched


def _stretches(shape: torch.Size) -> Tensor:
    return 0.5 * torch.randn(shape, generator=torch.Generator().manual_seed(1))


def oblong(gaussians: Gaussians) -> Gaussians:
    """The same with axes of different lengths: the picture then tells of every turn, so gradients by quaternions are
    more than rounding.
    """
    return replace(gaussians, scales=gaussians.scales * _stretches(gaussians.scales.shape).exp())


def certain(squares: list[Tensor]) -> Tensor:
    """Entries whose steps hang on no rounding: their root mean squares, once not zero, were never small."""
    roots = torch.stack(squares).cpu().double().sqrt()
    largest = roots.flatten(1).amax(1).reshape(-1, *[1] * squares[0].dim())
    return ((roots == 0) | (roots > FLOOR * largest)).all(0) & (roots[-1] > 0)


def assert_same_steps(found: Steps, expected: Steps) -> None:
    """`found` has the gradients of `expected`, step by step, and moved its parameters as far; but for rounding."""
    assert len(found.means) == len(expected.means) > 0
    for name in expected.start:
        for k, (a, b) in enumerate(zip(found.means, expected.means, strict=True)):
            bound = LATER if k else FIRST
            assert_close(f"step {k + 1}, gradient by {name}", a[name], b[name].cpu(), bound)
        sure = certain([squares[name] for squares in expected.squares])
        assert sure.double().mean() > LEAST, (
            f"{name}: too many gradients hang on rounding to compare the rest"
        )
        moved, wanted = ((steps.end[name] - steps.start[name]).cpu() for steps in (found, expected))
        assert_close(f"change of {name}", moved * sure, wanted * sure, MOVED)
