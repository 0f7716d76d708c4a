"""The two passes of a CPU iteration that are not rendering: the loss with its gradient, and the step."""

import math

import numpy as np
from numba import config, float32, float64

from tg4mm.fit.rasterize.kernels.compiled import inlined, part, shared
from tg4mm.fit.rasterize.kernels.layout import FEAT, FEATURES, POWER
from tg4mm.fit.rasterize.kernels.project import ROWS
from tg4mm.fit.rasterize.kernels.project_backward import backward_rows

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15  # Adam's; torch's defaults but for the last
# Places in `rates`: the step sizes of the parameters, those of the SH coefficients 0 and 1 … apart.
MEANS, QUATS, LOG_SCALES, LOGITS, SH0, SHN = range(6)


@shared
def compare(
    worker,
    workers,
    image,
    transmittance,
    target,
    white,
    gain,
    scale,
    l2,
    more,
    v_image,
    v_transmittance,
    squares,
):
    """Gradient of scale · (L1 + l2 · MSE) by image and transmittance, and the error for the carrier channel.

    The picture is image [H, W, FEATURES] over white, times gain [3]; target [H, W, 3]. `more` [H, W, 3] is added to the
    gradient by the picture; empty: nothing. v_image gets |error|, summed over colours, in its last channel; `squares`
    [H] the squared errors of every row.
    """
    height, width = transmittance.shape
    one = float32(scale / (3 * height * width))
    two = float32(2.0 * l2) * one
    for y in range(worker, height, workers):
        total = float64(0.0)
        for x in range(width):
            behind = transmittance[y, x] * float32(white)
            error, pull = float32(0.0), float32(0.0)
            for c in range(3):
                d = (image[y, x, c] + behind) * gain[c] - target[y, x, c]
                sign = float32(d > float32(0.0)) - float32(d < float32(0.0))
                g = one * sign + two * d
                if len(more) > 0:
                    g += more[y, x, c]
                g *= gain[c]
                v_image[y, x, c] = g
                pull += g
                error += abs(d)
                total += d * d
            v_image[y, x, FEATURES - 1] = error
            v_transmittance[y, x] = pull * float32(white)
        squares[y] = total


@part  # no fastmath: the same bits wherever it is compiled into
def _activate_rows(log_scales, logits, scales, opacities):
    one = float32(1.0)
    for i in range(len(logits)):
        for k in range(3):
            scales[i, k] = math.exp(log_scales[i, k])
        opacities[i] = one / (one + math.exp(-logits[i]))


@shared
def activate(worker, workers, log_scales, logits, scales, opacities):
    """Activate the free parameters: scales [N, 3] and opacities [N]."""
    n = len(logits)
    for chunk in range(worker, (n + ROWS - 1) // ROWS, workers):
        a, b = chunk * ROWS, min(n, chunk * ROWS + ROWS)
        _activate_rows(log_scales[a:b], logits[a:b], scales[a:b], opacities[a:b])


# No fastmath in a step: its last bits would depend on whether this process compiled it or found it in the cache.
@inlined
def _adam(value, m, v, gradient, rate, root):
    """One number's step. rate: learning rate / (1 − β1^t); root: 1 / √(1 − β2^t)."""
    m = m + float32(1 - BETA1) * (gradient - m)
    v = float32(BETA2) * v + float32(1 - BETA2) * gradient * gradient
    return value - rate * m / (math.sqrt(v) * root + float32(EPSILON)), m, v


@part
def _step_flat(values, ms, vs, gradients, rate, root):
    for k in range(len(values)):
        values[k], ms[k], vs[k] = _adam(values[k], ms[k], vs[k], gradients[k], rate, root)


@part
def _step_sh(values, ms, vs, gradients, rates, root):
    """Arrays [n, coefficients · 3]; the first `len(rates)` of a row are stepped, each at its own rate."""
    for i in range(len(values)):
        for k in range(len(rates)):
            values[i, k], ms[i, k], vs[i, k] = _adam(
                values[i, k], ms[i, k], vs[i, k], gradients[i, k], rates[k], root
            )


def scratch_shape(coefficients: int) -> tuple[int, int]:
    """Return the shape of the memory in which `step` works: a row for each thread there can be."""
    return config.NUMBA_NUM_THREADS, ROWS * (11 + 3 * coefficients)  # type: ignore[attr-defined]


@shared
def step(worker, workers, values, ms, vs, active, view, splats, v_splats, error, rates, root, room):
    """Step parameters and Adam's moments in place, from the sums of pairs (kernels/layout.py).

    values, ms, vs: (means [N, 3], quats [N, 4], log_scales [N, 3], logits [N], sh [N, K, 3]) and their moments.
    active: (scales, opacities), written anew. view: (degree, packed camera, width, height) of the picture. `v_splats`
    is read where visible; elsewhere the gradient is 0, which moves a parameter too. error [N] gets the carrier's
    share. SH coefficients beyond the degree are left alone: no view has asked for them yet, their moments are 0.
    room: what `scratch_shape(K)` says, for the gradients of the rows in work.
    """
    means, quats, log_scales, logits, sh = values
    scales, opacities = active
    degree, camera, width, height = view
    n, zero, one = len(logits), float32(0.0), float32(1.0)
    coefficients, asked = sh.shape[1], (degree + 1) * (degree + 1)
    sh_rates = np.empty(3 * asked, np.float32)
    for k in range(3 * asked):
        sh_rates[k] = rates[SH0] if k < 3 else rates[SHN]
    yes = n >= 0  # not a literal: for each value of it `backward_rows` would be compiled anew
    for chunk in range(worker, (n + ROWS - 1) // ROWS, workers):
        a, b = chunk * ROWS, min(n, chunk * ROWS + ROWS)
        local, m = room[worker], b - a
        local[:] = zero
        v_means, v_quats = local[: 3 * m].reshape((m, 3)), local[3 * m : 7 * m].reshape((m, 4))
        v_scales, v_opacities = local[7 * m : 10 * m].reshape((m, 3)), local[10 * m : 11 * m]
        v_sh = local[11 * m : (11 + 3 * coefficients) * m].reshape((m, coefficients, 3))
        backward_rows(
            means[a:b], quats[a:b], scales[a:b], sh[a:b], degree, camera, width, height,
            splats[a:b], v_splats[a:b], yes, v_means, v_quats, v_scales, v_opacities, v_sh,
        )  # fmt: skip
        for i in range(a, b):
            if splats[i, POWER] > zero:
                error[i] += v_splats[i, FEAT + FEATURES - 1]
            for k in range(3):
                v_scales[i - a, k] *= scales[i, k]
            v_opacities[i - a] *= opacities[i] * (one - opacities[i])
        _step_flat(
            means[a:b].reshape(-1), ms[0][a:b].reshape(-1), vs[0][a:b].reshape(-1), v_means.reshape(-1),
            rates[MEANS], root,
        )  # fmt: skip
        _step_flat(
            quats[a:b].reshape(-1), ms[1][a:b].reshape(-1), vs[1][a:b].reshape(-1), v_quats.reshape(-1),
            rates[QUATS], root,
        )  # fmt: skip
        _step_flat(
            log_scales[a:b].reshape(-1), ms[2][a:b].reshape(-1), vs[2][a:b].reshape(-1),
            v_scales.reshape(-1), rates[LOG_SCALES], root,
        )  # fmt: skip
        _step_flat(logits[a:b], ms[3][a:b], vs[3][a:b], v_opacities, rates[LOGITS], root)
        wide = (b - a, 3 * coefficients)
        _step_sh(
            sh[a:b].reshape(wide), ms[4][a:b].reshape(wide), vs[4][a:b].reshape(wide), v_sh.reshape(wide),
            sh_rates, root,
        )  # fmt: skip
        _activate_rows(log_scales[a:b], logits[a:b], scales[a:b], opacities[a:b])
