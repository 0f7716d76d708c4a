"""A training iteration on the CPU without torch around the kernels, and the optimiser that belongs to it."""

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.memory import Buffers
from tg4mm.fit.rasterize.kernels.binning import bin_splats, gather_sums
from tg4mm.fit.rasterize.kernels.blend import blend_forward
from tg4mm.fit.rasterize.kernels.blend_backward import blend_backward
from tg4mm.fit.rasterize.kernels.layout import FEATURES, SPLAT_WIDTH
from tg4mm.fit.rasterize.kernels.project import pack_camera, project_forward
from tg4mm.fit.space.kernels import BETA1, BETA2, activate, compare, scratch_shape, step
from tg4mm.fit.space.losses import GAIN_EVERY, fitting_gain, ssim
from tg4mm.fit.space.parameters import ParameterRows, learning_rates
from tg4mm.fit.space.view import EPS2D, FAR, NEAR, WHITE

_SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "logits": ()}
_NOTHING = np.empty((0, 0, 0), np.float32)
_PLAIN = np.ones(3, np.float32)


class FusedAdam(ParameterRows):
    """Adam in numpy arrays, SH coefficients in one of them; `parameters` are views of these as torch tensors."""

    def _build(self, parameters: dict[str, Tensor], moments: dict[str, Tensor] | None) -> None:
        self._steps = 0 if moments is None else int(moments["step"])
        given = {k: v.detach() for k, v in parameters.items()}
        self.values = _packed(given)
        self.first, self.second = (
            _packed({k: moments[k + kind] if moments else torch.zeros_like(v) for k, v in given.items()})
            for kind in (".m", ".v")
        )
        self._activate()

    def _activate(self) -> None:
        _, _, log_scales, logits, _ = self.values
        self.active = (np.empty_like(log_scales), np.empty_like(logits))
        activate(log_scales, logits, *self.active)
        self.parameters = _named(self.values)

    def replace(self, gone: Tensor, added: dict[str, Tensor]) -> None:
        """Replace rows as all optimisers do, without touching the others."""
        n, more = len(self.values[0]), len(added["logits"]) - len(gone)
        if more < 0:
            super().replace(gone, added)
            return
        rows = np.concatenate([gone.numpy(), np.arange(n, n + more)])
        self.values, self.first, self.second = (
            tuple(_lengthened(a, more) for a in arrays) for arrays in (self.values, self.first, self.second)
        )
        for value, first, second, new in zip(
            self.values, self.first, self.second, _packed(added), strict=True
        ):
            value[rows], first[rows], second[rows] = new, 0, 0
        self._activate()

    def reorder(self, order: Tensor) -> None:
        rows = order.numpy()
        self.values, self.first, self.second = (
            tuple(a[rows] for a in arrays) for arrays in (self.values, self.first, self.second)
        )
        self._activate()

    def moments(self) -> dict[str, Tensor]:
        if self._steps == 0:
            return {}
        out = {"step": torch.tensor(float(self._steps))}
        for kind, arrays in ((".m", self.first), (".v", self.second)):
            out |= {name + kind: value for name, value in _named(arrays).items()}
        return out

    def next_rates(self, progress: float, pace: float = 1.0) -> tuple[np.ndarray, np.float32]:
        """Count a step: its step sizes [6] by place in `kernels.step`, and the scale of the second moments' roots."""
        self._steps += 1
        rates = np.array(list(learning_rates(self._stride, progress, pace).values()))
        root = 1 / np.sqrt(1 - BETA2**self._steps)
        return (rates / (1 - BETA1**self._steps)).astype(np.float32), np.float32(root)


def _packed(p: dict[str, Tensor]) -> tuple[np.ndarray, ...]:
    """Copies of the named tensors in the order of `kernels.step`, both parts of the SH coefficients in one."""
    sh = torch.cat([p["sh0"], p["shn"]], 1)
    return (*(p[name].contiguous().numpy().copy() for name in _SHAPES), sh.contiguous().numpy())


def _lengthened(array: np.ndarray, more: int) -> np.ndarray:
    """The array with so many rows more, of undefined contents."""
    return np.concatenate([array, np.empty((more, *array.shape[1:]), array.dtype)]) if more else array


def _named(arrays: tuple[np.ndarray, ...]) -> dict[str, Tensor]:
    *plain, sh = (torch.from_numpy(a) for a in arrays)
    return dict(zip(_SHAPES, plain, strict=True)) | {"sh0": sh[:, :1], "shn": sh[:, 1:]}


def filled(target: np.ndarray, image: np.ndarray, transmittance: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return a target [H, W, 3] with the rendered picture where it is NaN, so that it has no gradient there."""
    is_masked = np.isnan(target[..., 0])
    if not is_masked.any():
        return target
    out = target.copy()
    out[is_masked] = (image[is_masked][:, :3] + np.float32(WHITE) * transmittance[is_masked][:, None]) * gain
    return out


class Iteration:
    """One view rendered, compared and stepped, in memory that is kept from one call to the next."""

    def __init__(self, l2: float, dssim: float) -> None:
        """Weights of the loss, as in `photometric_loss`."""
        self._l2, self._dssim = l2, dssim
        self._buffers = Buffers()

    def __call__(
        self,
        adam: FusedAdam,
        viewmat: np.ndarray,  # [4, 4]
        K: np.ndarray,  # [3, 3]
        target: np.ndarray,  # [H, W, 3] over white
        degree: int,  # of the SH coefficients in use
        progress: float,  # 0..1 of the whole fit
        error: np.ndarray,  # [N], gets each Gaussian's share of the picture's error
        gain: np.ndarray = _PLAIN,  # [3] of the picture, `losses.py`
        pace: float = 1.0,  # pixels of the dataset across one of this picture's
        eps2d: float = EPS2D,  # low-pass, squared pixels
    ) -> float:
        """Change `adam` by one step and return the picture's mean squared error before it."""
        take = self._buffers.take
        height, width = target.shape[:2]
        means, quats, _, logits, sh = adam.values
        scales, opacities = adam.active
        camera = pack_camera(viewmat, K, NEAR, FAR, eps2d)
        splats = take("splats", (len(logits), SPLAT_WIDTH))
        project_forward(means, quats, scales, opacities, sh, degree, camera, width, height, splats)
        bins = bin_splats(splats, width, height, self._buffers)
        tiles = (splats, bins.tile_start, bins.pair_gaussian, width, height)
        image, transmittance = (
            take("image", (height, width, FEATURES)),
            take("transmittance", (height, width)),
        )
        blend_forward(*tiles, image, transmittance, reached=bins.reached)
        v_image, v_transmittance = take("v_image", image.shape), take("v_transmittance", (height, width))
        squares = take("squares", (height,), np.float64)
        target = filled(target, image, transmittance, gain)
        more = self._structure(image, transmittance, target, gain)
        share = 1 - self._dssim
        loss = (share, self._l2, more)
        compare(image, transmittance, target, WHITE, gain, *loss, v_image, v_transmittance, squares)
        pair_sums = take("pair_sums", (len(bins.pair_gaussian), SPLAT_WIDTH))
        blend_backward(
            *tiles, image, transmittance, v_image, v_transmittance, pair_sums, reached=bins.reached
        )
        v_splats = take("v_splats", splats.shape)
        gather_sums(bins.order, bins.n_visible, bins.gaussian_start, bins.pair_slot, pair_sums, v_splats)
        rates, root = adam.next_rates(progress, pace)
        step(
            adam.values, adam.first, adam.second, adam.active, (degree, camera, width, height),
            splats, v_splats, error, rates, root, take("room", scratch_shape(sh.shape[1])),
        )  # fmt: skip
        return float(squares.sum()) / target.size

    def fitting_gain(self, target: np.ndarray) -> np.ndarray:
        """Return [3] that would have suited the last picture best, whose target [H, W, 3] it was."""
        height, width = target.shape[:2]
        image = self._buffers.take("image", (height, width, FEATURES))
        transmittance = self._buffers.take("transmittance", (height, width))
        every = (slice(None, None, GAIN_EVERY),) * 2
        shown = image[every][..., :3] + np.float32(WHITE) * transmittance[every][..., None]
        return fitting_gain(shown, filled(target[every], image[every], transmittance[every], _PLAIN))

    def _structure(
        self, image: np.ndarray, transmittance: np.ndarray, target: np.ndarray, gain: np.ndarray
    ) -> np.ndarray:
        """Gradient of the D-SSIM term by the picture [H, W, 3], by torch; empty without that term."""
        if self._dssim == 0:
            return _NOTHING
        shown = (image[..., :3] + np.float32(WHITE) * transmittance[..., None]) * gain
        rgb = torch.from_numpy(shown).requires_grad_()
        (self._dssim * (1 - ssim(rgb, torch.from_numpy(target))) / 2).backward()
        assert rgb.grad is not None
        return rgb.grad.numpy()
