"""The CUDA path: gsplat's rasteriser behind our call, and one line for whatever of it may be missing.

gsplat takes our arguments as they are. What its kernels do otherwise than ours: docs/conventions.md, "Devices".
"""

import importlib
import inspect
from typing import Any

from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.extras import install

_INSTALL = install("cuda")


def require_gsplat() -> None:
    """Load gsplat's kernels, so that what is missing is said before any work; the first time ever that may compile.

    Raises Tg4mmError if gsplat is absent, too old, too new, or without kernels for this machine.
    """
    try:
        import gsplat
    except ImportError as error:
        raise Tg4mmError(f"device cuda needs gsplat: {_INSTALL}") from error
    if "opacities" not in inspect.signature(gsplat.fully_fused_projection).parameters:
        # it cut every Gaussian at three standard deviations, where an opaque one still has an alpha of 0.011
        raise Tg4mmError(f"gsplat {gsplat.__version__} is too old, tg4mm needs 1.5: {_INSTALL}")
    if "dirs" not in inspect.signature(gsplat.spherical_harmonics).parameters:
        # 1.6 takes means and viewmats instead, and lowered the largest alpha from 0.999 to 0.99: other pictures
        raise Tg4mmError(f"gsplat {gsplat.__version__} is too new, tg4mm needs 1.5: {_INSTALL}")
    try:
        kernels = importlib.import_module("gsplat.cuda._backend")._C
    except Exception as error:  # the compiler's, ninja's or the loader's; none has a type of its own
        # after an OSError of the build gsplat tries to load what was not built, and fails once more
        first = error.__context__ if isinstance(error.__context__, OSError) else error
        reason = (str(first).strip() or type(first).__name__).splitlines()[0]
        raise Tg4mmError(f"gsplat's CUDA kernels do not load: {reason}") from error
    if kernels is None:
        raise Tg4mmError(
            "gsplat is installed without CUDA kernels and finds no nvcc to build them: install the CUDA toolkit, "
            "or a wheel built for this torch (https://docs.gsplat.studio/whl)"
        )


def rasterize_cuda(*args: Any, **kwargs: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """`tg4mm.fit.rasterize.rasterization` of CUDA tensors, checked already. Raises Tg4mmError without gsplat."""
    try:
        from gsplat import rasterization
    except ImportError as error:
        raise Tg4mmError(f"device cuda needs gsplat: {_INSTALL}") from error
    # Packed tensors save memory where cameras see little of the scene; ours see nearly all of it.
    return rasterization(*args, packed=False, **kwargs)
