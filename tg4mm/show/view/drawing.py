"""Regions and a scale as they are drawn: clicks on a picture, one after the other."""

from dataclasses import dataclass, field, replace

from tg4mm.core.errors import RegionError
from tg4mm.core.regions import POINT_RADIUS, Region, Regions
from tg4mm.core.scale import Pixel, Scale

BOX, POLYGON, POINT, LENGTH, RECTANGLE = "box", "polygon", "point", "length", "rectangle"
TOOLS = {
    BOX: "Drag a box, or click two opposite corners.",
    POLYGON: "Click corners, then Finish.",
    POINT: "Click its middle.",
    LENGTH: "Give millimetres, then click both ends.",
    RECTANGLE: "Give width and height, then click its corners: upper left, upper right, lower right, lower left.",
}
_NEEDED = {BOX: 2, POINT: 1, LENGTH: 2, RECTANGLE: 4}


@dataclass(frozen=True)
class Drawing:
    """An immutable drawing on pictures of `size` (w, h), with the clicks of an unfinished shape."""

    size: Pixel
    regions: tuple[Region, ...] = ()
    scale: Scale | None = None
    tool: str = BOX
    clicks: tuple[Pixel, ...] = ()
    name: str = ""  # of the next region; "": numbered
    camera: str = ""
    sides_mm: Pixel = (0.0, 0.0)  # of a length the first, of a rectangle both
    before: "Drawing | None" = field(default=None, repr=False, compare=False)

    def taking(self, tool: str) -> "Drawing":
        """With another tool; clicks of an unfinished shape are dropped."""
        return replace(self, tool=tool, clicks=())

    def clicked(self, at: Pixel) -> "Drawing":
        """One more click, pixels. Raises Tg4mmError where what it finishes cannot be."""
        inside = (min(max(at[0], 0.0), self.size[0]), min(max(at[1], 0.0), self.size[1]))
        more = replace(self, clicks=(*self.clicks, inside), before=self)
        return more.finished() if len(more.clicks) == _NEEDED.get(self.tool) else more

    def dragged(self, first: Pixel, last: Pixel) -> "Drawing":
        """A box from corner to corner, pixels. Raises Tg4mmError where it cannot be, and with another tool."""
        if self.tool != BOX:
            raise RegionError(
                f"a box is dragged with the tool {BOX}; {self.tool}: {TOOLS[self.tool].lower()}"
            )
        return replace(self.taking(BOX).clicked(first).clicked(last), before=self)

    def finished(self) -> "Drawing":
        """The clicks made a shape. Raises Tg4mmError where they are none."""
        scale = self.scale or Scale()
        metres = [mm / 1e3 for mm in self.sides_mm]
        if self.tool == LENGTH:
            if metres[0] <= 0:
                raise RegionError("give the length in millimetres first")
            first, last = self.clicks
            return self._done(scale=replace(scale, lengths=(*scale.lengths, (first, last, metres[0]))))
        if self.tool == RECTANGLE:
            if min(metres) <= 0:
                raise RegionError("give the rectangle's width and height in millimetres first")
            return self._done(scale=replace(scale, corners=self.clicks, sides_m=(metres[0], metres[1])))
        region = Region(self.name.strip() or self._free_name(), *self._shape(), self.camera)
        return self._done(regions=(*self.regions, region))

    def _done(self, **changes: object) -> "Drawing":
        done = replace(self, clicks=(), name="", before=self, **changes)  # type: ignore[arg-type]
        done.as_file()
        return done

    def _shape(self) -> tuple[str, tuple[float, ...]]:
        if self.tool == POLYGON:
            if len(self.clicks) < 3:
                raise RegionError(f"a polygon has 3 corners or more; clicked are {len(self.clicks)}")
            return POLYGON, tuple(v for at in self.clicks for v in at)
        if self.tool == POINT:
            return POINT, (*self.clicks[0], POINT_RADIUS)
        (a, b), (c, d) = self.clicks
        return BOX, (min(a, c), min(b, d), max(a, c), max(b, d))

    def _free_name(self) -> str:
        taken = {region.name.lower() for region in self.regions}
        return next(f"region {k}" for k in range(1, len(taken) + 2) if f"region {k}" not in taken)

    def undone(self) -> "Drawing":
        """Return the drawing without its last click or shape."""
        return self if self.before is None else replace(self.before, tool=self.tool, camera=self.camera)

    def as_file(self, source: str = "") -> Regions:
        """Return the regions to write. Raises Tg4mmError if the drawing is invalid."""
        scale = self.scale if self.scale is not None and (self.scale.lengths or self.scale.corners) else None
        return Regions((int(self.size[0]), int(self.size[1])), self.regions, scale, source)


def opened(regions: Regions) -> Drawing:
    """Return the drawing stored in a file."""
    return Drawing(regions.size, regions.regions, regions.scale)
