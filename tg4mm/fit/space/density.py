"""Adaptive density control: Gaussians are added where the error is, within a fixed budget.

[3DGS] splits where the view-space gradient is large. Here a Gaussian's chance to be split is its share of the picture's
error since the last time (`view.py`), which finds thin structures whose gradients cancel; Gaussians that have faded or
grown past the scene are removed and replaced by new ones.
"""

import torch
from torch import Tensor

from tg4mm.fit.gaussians import rotation_matrices
from tg4mm.fit.space.parameters import ParameterRows

EVERY = 50  # iterations
FIRST = 100  # iteration
GROWTH = 0.05  # new Gaussians each time, as a share of those there, at least while the budget lasts
FADED = 0.005  # opacity below which a Gaussian is removed
HUGE = 0.5  # largest scale, as a share of the scene's extent, beyond which it is removed
SHRINK = 1.5  # the two halves of a split are narrower by this factor
APART = 0.7  # and stand on either side, this share of a random point of the old one away
DIM = 0.8  # opacity of each half, as a share of the old one's
SORTED_EVERY = 10  # rounds of density control, between which halves take places anywhere
# Shifts and masks after which two zeros follow each of a number's 21 bits
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def is_due(iteration: int, until: float) -> bool:
    """Return whether density control follows this iteration."""
    return iteration >= FIRST and iteration % EVERY == 0 and iteration < until


def growth(n: int, max_gaussians: int, iteration: int, caught_up: float) -> float:
    """New Gaussians in this round as a share of the n there are.

    `GROWTH`, or as much as reaches the budget by iteration `caught_up` in equal steps: from a few hundred points (SfM)
    the first alone would end far below it. A Gaussian is split at most once a round, so doubling is the most.
    """
    rounds = max(1, int(caught_up - iteration) // EVERY + 1)
    return min(1.0, max(GROWTH, (max_gaussians / max(n, 1)) ** (1 / rounds) - 1))


def split_rows(parameters: dict[str, Tensor], rows: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Two narrower Gaussians for each of `rows`, on either side of it along a random point drawn from it.

    The generator's device may be another than the parameters'.
    """
    old = {name: p.detach()[rows] for name, p in parameters.items()}
    noise = torch.randn(len(rows), 3, generator=generator, device=generator.device).to(old["means"].device)
    offset = (
        torch.einsum("nij,nj->ni", rotation_matrices(old["quats"]), noise * old["log_scales"].exp()) * APART
    )
    # a CPU scalar goes with any device
    old["log_scales"] = old["log_scales"] - torch.log(torch.tensor(SHRINK))
    old["logits"] = torch.logit((old["logits"].sigmoid() * DIM).clamp(1e-3, 0.999))
    halves = {name: torch.cat([value, value]) for name, value in old.items()}
    halves["means"] = torch.cat([old["means"] + offset, old["means"] - offset])
    return halves


def control_density(
    adam: ParameterRows,
    error: Tensor,  # [N] each Gaussian's share of the error since the last round
    extent: float,
    max_gaussians: int,
    generator: torch.Generator,
    share: float = GROWTH,
) -> tuple[int, int]:
    """Run one round; return how many were removed and split.

    share: new Gaussians as a share of those there (`growth`), beside those that replace removed ones. Chances are drawn
    where the generator lives; beside it, only counts leave the device.
    """
    p = adam.parameters
    with torch.no_grad():
        alive = (p["logits"].sigmoid() >= FADED) & (p["log_scales"].exp().amax(1) <= HUGE * extent)
        n_alive = int(alive.sum())
        removed = len(alive) - n_alive
        room = min(max_gaussians - n_alive, int(share * len(alive)) + removed)
        chance = torch.where(alive, error.clamp_min(0), torch.zeros_like(error)).to(generator.device)
        room = min(room, int((chance > 0).sum()))
        if room > 0:
            chosen = torch.multinomial(chance, room, replacement=False, generator=generator).to(alive.device)
        else:
            chosen = torch.empty(0, dtype=torch.long, device=alive.device)
        gone = torch.cat([chosen, torch.nonzero(~alive)[:, 0]])  # one half takes the place of what was split
        adam.replace(gone, split_rows(p, chosen, generator))
    return removed, len(chosen)


def is_sorting_due(iteration: int, until: float) -> bool:
    """Return whether this round of density control ends with sorting the rows: every tenth does, and the last."""
    return iteration % (SORTED_EVERY * EVERY) == 0 or iteration + EVERY >= until


def along_a_curve(means: Tensor) -> Tensor:
    """The order [N] of means [N, 3] along a Morton curve, on which most neighbours in space are neighbours."""
    if len(means) == 0:
        return torch.arange(0, device=means.device)
    low, high = means.amin(0), means.amax(0)
    cells = ((means - low) / (high - low).clamp_min(1e-30) * (2**21 - 1)).long()
    for shift, mask in _SPREAD:
        cells = (cells | cells << shift) & mask
    return torch.argsort(cells[:, 0] | cells[:, 1] << 1 | cells[:, 2] << 2, stable=True)
