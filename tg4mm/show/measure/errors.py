"""What a user of `tg4mm measure` can mend."""

from tg4mm.core.errors import Tg4mmError


class MeasureError(Tg4mmError):
    """A sensor that cannot be read, that holds no Gaussian, or that no picture shows."""
