"""Display of lengths: millimetres if the file states its scale, else scene units."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """A unit of length: its size relative to a scene unit, and the number of digits shown."""

    per_scene_unit: float
    name: str  # beside a number
    column: str  # in the name of a column
    digits: int = 4  # significant

    def text(self, length: float, deviation: float | None = None) -> str:
        """`length` in scene units → "0.034 mm"; with its standard deviation, "0.034 ± 0.002 mm"."""
        sure = "" if deviation is None else f" ± {deviation * self.per_scene_unit:.2g}"
        return f"{self.number(length)}{sure} {self.name}"

    @property
    def short(self) -> str:
        """The name where there is little room."""
        return self.name.removeprefix("scene ")

    def number(self, length: float) -> str:
        """The same without the unit's name."""
        return f"{length * self.per_scene_unit:.{self.digits}g}"


def unit_of(unit_scale_m: float | None, metric: bool = True, digits: int = 4) -> Unit:
    """Return millimetres if the scale (metres per scene unit) is known and requested, else scene units."""
    if unit_scale_m is None or not metric:
        return Unit(1.0, "scene units", "scene_units", digits)
    return Unit(1000.0 * unit_scale_m, "mm", "mm", digits)
