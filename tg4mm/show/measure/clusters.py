"""Clusters of Gaussians that move alike: by their motion in the run's modes, then by neighbourhood."""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tg4mm.fit.motion.prior import nearest
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensors import STILL

_MOVES = 0.1  # of the strongest motion: less is static
_SIGNIFICANT = 2.0  # deviations that a motion must exceed
_EXPLAINED = 0.95  # of the moving Gaussians' variance
_BETTER = 0.2  # of the unexplained variance: another centre must explain as much
_MOST = 6  # centres, and clusters
_FEWEST = 12  # Gaussians
_SHARE = 0.02  # of all motion, by amplitude and visibility: a smaller cluster is not reported
_SEEN = 0.25  # pixels of blending weight: less is not visible
_NEIGHBOURS = 8


@dataclass(frozen=True)
class Clusters:
    """Clusters, numbered from 1 by falling amplitude; 0 is the static one."""

    members: dict[int, np.ndarray]  # indices of Gaussians
    names: dict[int, str]


def clusters_of(scene: Prepared) -> Clusters:
    """Return the clusters of a run.

    Motion below a tenth of the strongest, or below twice its deviation, counts as static.
    """
    fields = scene.modal.fields[..., :3].astype(np.float64)
    n = len(scene.means)
    seen = scene.seen > _SEEN
    power = (_coordinates(scene, fields) ** 2).sum(1)
    rms = np.sqrt(power)
    limit = _MOVES * (np.percentile(rms[seen], 99.5) if seen.any() else 0.0)
    deviation = scene.fit.uncertainty.get("displacement")
    least = np.full(n, limit) if deviation is None else np.maximum(limit, _SIGNIFICANT * deviation)
    moving = np.flatnonzero(seen & (rms > least)) if limit > 0 else np.zeros(0, int)
    still = np.setdiff1d(np.flatnonzero(seen & (rms <= limit)), moving)
    groups = []
    if len(moving) >= _FEWEST:
        groups = _grouped(scene, _coordinates(scene, fields[:, moving]), moving, rms)
    members = dict(enumerate(groups, 1))
    names = {k: f"moving {k}" for k in members}
    if len(still) >= _FEWEST:
        members[STILL], names[STILL] = still, "still"
    return Clusters(members, names)


def _coordinates(scene: Prepared, fields: np.ndarray) -> np.ndarray:
    """Return coordinates [N, D] of fields [R, N, 3] whose distances are the motions' rms distances, scene units."""
    gram = np.mean([c.series @ c.series.T / c.series.shape[1] for c in scene.clocks], axis=0)
    if not len(gram):
        return np.zeros((fields.shape[1], 1))
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return np.einsum("rq,rnc->nqc", root, fields).reshape(fields.shape[1], -1)


def _grouped(scene: Prepared, positions: np.ndarray, rows: np.ndarray, rms: np.ndarray) -> list[np.ndarray]:
    """Return the indices of each cluster, by falling amplitude: k-means of motions, split into connected parts."""
    labels = _labels(positions)
    _, index = nearest(scene.gaussians.means.numpy()[rows], min(_NEIGHBOURS, len(rows) - 1))
    of, to = np.repeat(np.arange(len(rows)), index.shape[1]), index.ravel()
    same = labels[of] == labels[to]
    edges = coo_matrix((np.ones(same.sum()), (of[same], to[same])), shape=(len(rows),) * 2)
    _, parts = connected_components(edges, directed=False)
    counts = scene.seen[rows] * rms[rows]
    groups = []
    for part in range(parts.max() + 1):
        own = np.flatnonzero(parts == part)
        if len(own) >= _FEWEST and counts[own].sum() >= _SHARE * counts.sum():
            amplitude = float(np.average(rms[rows[own]], weights=scene.seen[rows[own]]))
            groups.append((amplitude, rows[own]))
    groups.sort(key=lambda g: -g[0])
    return [g for _, g in groups[:_MOST]]


def _labels(positions: np.ndarray) -> np.ndarray:
    """Return labels [n] by k-means with as few centres as explain most of the motions' variance."""
    total = float(((positions - positions.mean(0)) ** 2).sum())
    power = float((positions**2).sum())
    best, left = np.zeros(len(positions), int), total
    for k in range(2, _MOST + 1):
        if left <= (1 - _EXPLAINED) * power:
            break
        centres, labels = kmeans2(positions, k, minit="++", seed=0)
        new = float(((positions - centres[labels]) ** 2).sum())
        if new > (1 - _BETTER) * left:
            break
        best, left = labels, new
    return best
