"""What halves of the data get wrong alike: to be calibrated."""
from __future__ import annotations
from tg4mm.measure.prepared import Prepared
from tg4mm.measure.rigid import Body
from tg4mm.measure.series import Series


def with_model_error(series: Series, body: Body, scene: Prepared) -> Series:
    return series
