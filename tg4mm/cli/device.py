"""The option --device, shared by the commands that render."""

from enum import StrEnum
from typing import Annotated

import typer


class Device(StrEnum):
    """Where tensors live."""

    cpu = "cpu"
    cuda = "cuda"


DeviceOption = Annotated[Device, typer.Option(help="cuda needs an NVIDIA GPU and the extra `cuda` (gsplat).")]
