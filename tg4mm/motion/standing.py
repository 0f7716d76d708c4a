"""Where the linear fit of the motion stands: what its checkpoint holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.motion.solver.solve import CGState, on_cpu, placed


@dataclass
class Fit:
    """Where the fit stands: `shapes` [P R, N, DOF], the first `component` of them found, and what is being solved.

    Where the cameras are halved (P = 2), those of the first half come first.
    """

    shapes: np.ndarray
    component: int = 0
    # of the components from `component` on; empty: not begun
    cgs: list[CGState] = field(default_factory=list)

    def tensors(self) -> dict[str, Tensor]:
        out = {"shapes": torch.from_numpy(self.shapes)}
        for name in ("x", "residual", "direction") if self.cgs else ():
            out[name] = torch.from_numpy(np.stack([on_cpu(getattr(cg, name)) for cg in self.cgs]))
        return out

    def state(self) -> dict[str, Any]:
        cgs = [{"initial": cg.initial, "iteration": cg.iteration} for cg in self.cgs]
        return {"component": self.component, "cgs": cgs}

    @staticmethod
    def restored(checkpoint: tuple[dict[str, Tensor], dict[str, Any]], device: str = "cpu") -> Fit:
        """From what `tensors` and `state` gave."""
        tensors, state = checkpoint
        a = {k: v.numpy() for k, v in tensors.items()}
        cgs = [
            placed(CGState(a["x"][k], a["residual"][k], a["direction"][k], **numbers), device)
            for k, numbers in enumerate(state["cgs"])
        ]
        return Fit(a["shapes"], state["component"], cgs)
