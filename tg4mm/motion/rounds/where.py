"""Where the rounds of `rounds.py` stand: what a checkpoint holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.gaussians import Gaussians
from tg4mm.motion.pictures.states import States, labelled
from tg4mm.motion.rounds.evidence import Errors
from tg4mm.motion.rounds.polish import Polish
from tg4mm.motion.solver.pcg import CGState, placed

VERSION = 3  # of a checkpoint

_PLAIN = ("neighbours", "pixels", "misfits", "is_chosen", "is_over")


@dataclass
class Where:
    """Where the rounds stand."""

    gaussians: Gaussians
    fields: np.ndarray  # [P, R, N, DOF] of each part of the cameras, as accepted
    neighbours: float  # weight of the neighbours, of this round once it is chosen
    states: States
    pixels: float  # that things move by at the state that moves most, by the linear fit
    misfits: list[float] = field(default_factory=list)  # before the first round and after each
    found: list[np.ndarray] = field(default_factory=list)  # [R, N, DOF] of the parts solved in this round
    cg: CGState | None = None
    polish: Polish | None = None  # once this round's motion is accepted
    reached: Errors | None = None  # by that motion
    is_chosen: bool = False
    is_over: bool = False

    @property
    def round(self) -> int:
        return max(len(self.misfits) - 1, 0)

    def tensors(self) -> dict[str, Tensor]:
        out = {f"g.{f.name}": getattr(self.gaussians, f.name) for f in fields(self.gaussians)}
        out["fields"] = torch.from_numpy(self.fields)
        if self.found:
            out["found"] = torch.from_numpy(np.stack(self.found))
        if self.cg is not None:
            for name in ("x", "residual", "direction"):
                value = getattr(self.cg, name)
                out[f"cg.{name}"] = torch.from_numpy(value) if isinstance(value, np.ndarray) else value.cpu()
        if self.polish is not None:
            out |= {f"p.{k}": v for k, v in self.polish.tensors().items()}
        return {k: v.contiguous() for k, v in out.items()}

    def state(self) -> dict[str, Any]:
        cg = self.cg and {"initial": self.cg.initial, "iteration": self.cg.iteration}
        polish = self.polish and self.polish.state()
        plain = {k: getattr(self, k) for k in _PLAIN}
        plain["reached"] = self.reached and asdict(self.reached)
        out = {"version": VERSION, "cg": cg, "polish": polish, "states": self.states.of.tolist()}
        return out | plain


Checkpoint = tuple[dict[str, Tensor], dict[str, Any]]


def usable(checkpoint: Checkpoint | None) -> Checkpoint | None:
    """The checkpoint, None if it is of another version."""
    return checkpoint if checkpoint and checkpoint[1].get("version") == VERSION else None


def restored(
    tensors: Mapping[str, Tensor],
    state: Mapping[str, Any],
    basis: np.ndarray,
    size: tuple[int, int],
    device: str,
) -> Where:
    """From what `Where.tensors` and `Where.state` gave."""

    def part(prefix: str) -> dict[str, Tensor]:
        return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}

    plain = {k: state[k] for k in _PLAIN}
    states = labelled(basis, np.array(state["states"]))
    where = Where(Gaussians(**part("g.")), tensors["fields"].numpy(), states=states, **plain)
    where.reached = Errors(**state["reached"]) if state["reached"] else None
    where.found = list(tensors["found"].numpy()) if "found" in tensors else []
    if state["cg"]:
        arrays = {k: v.numpy() for k, v in part("cg.").items()}
        cg = CGState(arrays["x"], arrays["residual"], arrays["direction"], **state["cg"])
        where.cg = placed(cg, device)
    if state["polish"]:
        where.polish = Polish.restored(part("p."), state["polish"], where.gaussians, size, device)
    return where
