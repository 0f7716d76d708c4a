"""Clusters of Gaussians that move alike: by their motion in the run's modes, then by neighbourhood."""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tg4mm.fit.motion.prior import nearest
from tg4mm.show.measure.scene import Prepared
from tg4mm.show.measure.sensors import STILL

_MOVES = 0.1  # of the strongest motion: less stands still
_TOLD = 2.0  # deviations that a motion must stand out of
_EXPLAINED = 0.95  # of the moving ones' variance
_BETTER = 0.2  # of what is left: another centre must explain as much
_MOST = 6  # centres, and clusters
_FEWEST = 12  # Gaussians
_SHARE = 0.02  # of what moves, by amplitude and by what is seen: a smaller cluster is not reported
_SEEN = 0.25  # pixels of blending weight: less says nothing
_NEIGHBOURS = 8


@dataclass(frozen=True)
class Clusters:
    """Numbered from 1 by falling amplitude; 0 is what stands still."""

    members: dict[int, np.ndarray]  # indices of Gaussians
    names: dict[int, str]


def clusters_of(scene: Prepared) -> Clusters:
    """Return the clusters of a run.

    What moves less than a tenth of the strongest motion, or than twice its deviation, stands still.
    """
    fields = scene.modal.fields[..., :3].astype(np.float64)
    n = len(scene.means)
    seen = scene.seen > _SEEN
    power = (_coordinates(scene, fields) ** 2).sum(1)
    rms = np.sqrt(power)
    limit = _MOVES * (np.percentile(rms[seen], 99.5) if seen.any() else 0.0)
    deviation = scene.fit.uncertainty.get("displacement")
    least = np.full(n, limit) if deviation is None else np.maximum(limit, _TOLD * deviation)
    moving = np.flatnonzero(seen & (rms > least)) if limit > 0 else np.zeros(0, int)
    still = np.setdiff1d(np.flatnonzero(seen & (rms <= limit)), moving)
    groups = (
        _grouped(scene, _coordinates(scene, fields[:, moving]), moving, rms) if len(moving) >= _FEWEST else []
    )
    members = {k + 1: g for k, g in enumerate(groups)}
    names = {k: f"moving {k}" for k in members}
    if len(still) >= _FEWEST:
        members[STILL], names[STILL] = still, "still"
    return Clusters(members, names)


def _coordinates(scene: Prepared, fields: np.ndarray) -> np.ndarray:
    """[N, D] of fields [R, N, 3]: scene units, whose distances are those of the motions, rms over time."""
    gram = np.mean([c.series @ c.series.T / c.series.shape[1] for c in scene.clocks], axis=0)
    if not len(gram):
        return np.zeros((fields.shape[1], 1))
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return np.einsum("rq,rnc->nqc", root, fields).reshape(fields.shape[1], -1)


def _grouped(scene: Prepared, places: np.ndarray, rows: np.ndarray, rms: np.ndarray) -> list[np.ndarray]:
    """Indices of each cluster, by falling amplitude: k-means of motions, parted where they do not touch."""
    labels = _labels(places)
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


def _labels(places: np.ndarray) -> np.ndarray:
    """[n] by k-means with as few centres as explain most of the motions' variance."""
    total = float(((places - places.mean(0)) ** 2).sum())
    power = float((places**2).sum())
    best, left = np.zeros(len(places), int), total
    for k in range(2, _MOST + 1):
        if left <= (1 - _EXPLAINED) * power:
            break
        centres, labels = kmeans2(places, k, minit="++", seed=0)
        new = float(((places - centres[labels]) ** 2).sum())
        if new > (1 - _BETTER) * left:
            break
        best, left = labels, new
    return best
