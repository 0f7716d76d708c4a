"""The views of a Gauss-Newton iteration: Jacobians where things have moved to, at few states for all timesteps.

States less than 0.7 pixels apart share a knot, at which the views are linearised. A knot l with Jacobian J_l, whose
timesteps t have the functions of time a(t), couples the fields by M_l = Σ a(t) a(t)ᵀ = C_lᵀ C_l: to the solver it is
further views with the mixing matrix C_l.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import moved
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.jacobian.view import VIEW_BYTES, ViewJacobian, view_jacobian
from tg4mm.fit.motion.nuisance.projection import Nuisance, projections_of
from tg4mm.fit.motion.solver.cuda import operator_on, views_on
from tg4mm.fit.motion.solver.operator import Array, Fold, Operator
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.states import StateObservations, states_of

KNOTS = 5  # at most: each costs as much as the problem at rest
KNOT_PX = 0.7  # states less apart share one


@dataclass(frozen=True)
class Knot:
    """States that share Jacobians."""

    views: list[ViewJacobian]  # of all cameras, where things are in these states
    states: np.ndarray  # rows of `StateObservations.states`
    mixing: np.ndarray  # C_l [ρ, R]


def knots_of(
    gaussians: Gaussians,
    views: Sequence[ViewJacobian],
    fields: np.ndarray,
    observed: StateObservations,
) -> list[Knot]:
    """Knots of the motion `fields` [R, N, 6]; `views`: the Jacobians at rest."""
    states, motions = observed.states, observed.moved(fields).motions
    knots = states_of(states.gains.T, pixels_moved(views, fields[..., :3]), KNOTS, KNOT_PX)
    out = []
    for knot in range(len(knots.gains)):
        own = np.flatnonzero(knots.of == knot)
        share = states.count[own] / states.count[own].sum()
        motion = torch.from_numpy(np.tensordot(share, motions[own], 1).astype(np.float32))
        there = moved(gaussians, motion)
        is_large = len(knots.gains) * sum(view.nbytes for view in views) > VIEW_BYTES
        height, width = observed.pictures.shape[2:4]
        each = (view_jacobian(there, camera, (width, height)) for camera in observed.cameras)
        jacobians = [view.stored() if is_large else view for view in each]
        out.append(Knot(jacobians, own, _root(states.products[own].sum(0))))
    return out


def targets_at(
    knots: Sequence[Knot], fold: Fold, residuals: np.ndarray, fields: np.ndarray, observed: StateObservations
) -> Iterator[np.ndarray]:
    """C_lᵀ times the target images [R, H, W, 3] of each knot and view, one at a time: all are gigabytes at 1080p."""
    for knot in knots:
        for v in fold.views:
            shown = knot.views[v].jvp(fields)
            knot.views[v].release()
            yield observed.target_images(v, residuals, knot.states, shown)


def coupled_operator(
    problem: Problem,
    at_rest: Problem,
    knots: Sequence[Knot],
    fold: Fold,
    smoothness_weight: float,
    targets: Iterable[np.ndarray],
) -> tuple[Operator, Array]:
    """One fold with the views of all knots, and its right-hand sides.

    What is projected out is as in the problem `at_rest` of the linear fit.
    """
    rest = problem.on_cpu(fold, smoothness_weight)
    views, rows = [knot.views[v] for knot in knots for v in fold.views], [*fold.views] * len(knots)
    weights = None if rest.weights is None else np.concatenate([rest.weights] * len(knots))
    nuisances: list[Nuisance] = []
    if at_rest.nuisances:
        nuisances = [replace(at_rest.nuisances[v], view=own) for v, own in zip(rows, views, strict=True)]
    means = None if at_rest.means is None else [at_rest.means[v] for v in rows]
    projections = projections_of(nuisances, means, weights)
    plain = replace(rest, views=views, weights=weights, projections=projections)
    mixing = [knot.mixing for knot in knots for _ in fold.views]
    there = views_on(problem.device, views, problem.graph)
    b = operator_on(there, plain).right_hand_sides(targets)
    return operator_on(there, replace(plain, mixing=mixing)), b


def _root(products: np.ndarray) -> np.ndarray:
    """C [ρ, R] float32 with Cᵀ C = `products` [R, R]."""
    values, vectors = np.linalg.eigh(products)
    keep = values > 1e-9 * max(float(values[-1]), 1e-30)
    return (vectors[:, keep] * np.sqrt(values[keep])).T.astype(np.float32)
