"""A pretended GPU: tensors that torch takes to lie on another device, with their numbers in the CPU's memory.

What goes wrong first where a program moves to a GPU is not arithmetic: a tensor left behind, a number fetched in every
iteration, a wait. Without a GPU none of that shows, since everything is on one device. Here an operation on tensors of
two devices raises, and what crosses to the host or back, or would wait for the device because of its result's size, is
counted. gsplat's two calls are made by our CPU path, at which nothing is counted.

`register` before the process's first backward pass: torch makes a queue for each device it knows by then. It cannot be
undone; a process that has it takes it for its accelerator.

It cannot show what CUDA's own kernels do: their results, speed and memory.
"""

from __future__ import annotations

import sys
import types
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

NAME = "pretended"
_aten = torch.ops.aten
_FETCHES = (_aten._local_scalar_dense.default, _aten.equal.default)
# how many numbers they give is known only once the device has worked it out
_WAITS = (
    _aten.nonzero.default,
    _aten.masked_select.default,
    _aten._unique2.default,
    _aten.unique_dim.default,
    _aten.unique_consecutive.default,
    _aten.repeat_interleave.Tensor,
    _aten.bincount.default,
)
_BY_INDEX = (_aten.index.Tensor, _aten.index_put_.default)  # by a mask they wait, too
_WITHOUT_SCALARS = (
    _aten.cat.default,
    _aten.stack.default,
    _aten.copy_.default,
)  # others take a number of the CPU's


@cache
def register() -> None:
    """Once in a process: torch knows the device."""
    backend_registration._setup_privateuseone_for_python_backend(NAME)


class There(Tensor):
    """A tensor of the pretended GPU; `here` holds its numbers."""

    here: Tensor
    is_cuda = property(lambda self: True)  # type: ignore[assignment]
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, here: Tensor) -> There:
        strided = here.layout == torch.strided
        return Tensor._make_wrapper_subclass(  # type: ignore[attr-defined, no-any-return]
            cls, here.size(), strides=here.stride() if strided else None, dtype=here.dtype, device=f"{NAME}:0"
        )

    def __init__(self, here: Tensor) -> None:
        self.here = here

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func} outside of the pretended GPU")

    def __repr__(self) -> str:
        return f"There({self.here!r})"


def _is_there(device: Any) -> bool:
    return device is not None and torch.device(device).type == NAME


class Generator(torch.Generator):
    """torch has none for a device that is written in Python: the CPU's."""

    def __new__(cls, device: Any = "cpu") -> Generator:
        return super().__new__(cls, "cpu" if _is_there(device) else device)


class Gpu(TorchDispatchMode):
    """Operations on the device, while it is active: `counts` of what crosses to and from the host, and of waits."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        asked = kwargs.get("device")
        tensors = [t for t in tree_leaves((args, kwargs)) if isinstance(t, Tensor)]
        there = [t for t in tensors if isinstance(t, There)]
        if not there and not _is_there(asked):
            return func(*args, **kwargs)
        self._watch(func, args, asked, tensors)
        comes_back = asked is not None and not _is_there(asked)
        if asked is not None:
            kwargs["device"] = "cpu"
        args, kwargs = tree_map_only(There, lambda t: t.here, (args, kwargs))
        out = func(*args, **kwargs)
        if comes_back:
            return out.clone() if any(out is t.here for t in there) else out
        known = {id(t.here): t for t in there} | {id(t): t for t in tensors if not isinstance(t, There)}
        return tree_map_only(Tensor, lambda t: known[id(t)] if id(t) in known else There(t), out)

    def _watch(self, func: Any, args: Any, asked: Any, tensors: list[Tensor]) -> None:
        left = [t for t in tensors if not isinstance(t, There) and (t.dim() or func in _WITHOUT_SCALARS)]
        if func is _aten.copy_.default and left:
            self.counts["up" if isinstance(args[0], There) else "down"] += 1
        elif func is _aten._to_copy.default:
            is_there, goes_there = isinstance(args[0], There), _is_there(asked)
            if asked is not None and is_there != goes_there:
                self.counts["up" if goes_there else "down"] += 1
        elif left and len(left) < len(tensors):
            shapes = ", ".join(str(tuple(t.shape)) for t in left)
            raise RuntimeError(f"{func}: expected all tensors on one device, found {shapes} on the CPU")
        is_mask = func in _BY_INDEX and any(t.dtype == torch.bool and t.dim() for t in tensors[1:])
        self.counts["down"] += func in _FETCHES
        self.counts["waits"] += func in _WAITS or is_mask

    def made_here(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function` of CPU tensors as one of the device's, gradients included; nothing of it is counted."""

        class Down(torch.autograd.Function):
            @staticmethod
            def forward(ctx: Any, value: Tensor) -> Tensor:
                assert isinstance(value, There)
                return value.here.clone()

            @staticmethod
            def backward(ctx: Any, gradient: Tensor) -> Tensor:
                return There(gradient)

        class Up(torch.autograd.Function):
            @staticmethod
            def forward(ctx: Any, value: Tensor) -> Tensor:
                return There(value.clone())

            @staticmethod
            def backward(ctx: Any, gradient: Tensor) -> Tensor:
                assert isinstance(gradient, There)
                return gradient.here

        def called(*args: Any, **kwargs: Any) -> Any:
            args, kwargs = tree_map_only(Tensor, lambda t: Down.apply(t), (args, kwargs))
            return tree_map_only(Tensor, lambda t: Up.apply(t), function(*args, **kwargs))

        return called


def gsplat_of(gpu: Gpu, harmonics: Callable[..., Tensor]) -> types.ModuleType:
    """A gsplat whose calls are our CPU path's."""
    from tg4mm.fit.rasterize import rasterization

    def rasterize(*args: Any, packed: bool, **kwargs: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        renders, alphas, _ = rasterization(*args, **kwargs)
        return renders, alphas, {}

    module = types.ModuleType("gsplat")
    module.rasterization = gpu.made_here(rasterize)  # type: ignore[attr-defined]
    module.spherical_harmonics = gpu.made_here(harmonics)  # type: ignore[attr-defined]
    return module


@contextmanager
def pretended_gpu(monkeypatch: pytest.MonkeyPatch, harmonics: Callable[..., Tensor]) -> Iterator[Gpu]:
    with Gpu() as gpu:
        monkeypatch.setitem(sys.modules, "gsplat", gsplat_of(gpu, harmonics))
        monkeypatch.setattr(torch, "Generator", Generator)
        real = torch.tensor  # makes its result where no mode sees it

        def tensor(data: Any, device: Any = None, **kwargs: Any) -> Tensor:
            made = real(data, **kwargs)
            return made if device is None else made.to(device)

        monkeypatch.setattr(torch, "tensor", tensor)
        yield gpu
