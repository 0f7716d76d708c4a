"""Regions and a scale drawn click by click, the texture that makes motion measurable, and the picture of both."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tg4mm.capture.look.baseline import LEAST_INFORMATION, QUANTISED
from tg4mm.capture.look.reading import CELL
from tg4mm.capture.tracking.template import FROZEN, Grid, Template, false_information
from tg4mm.core.errors import RegionError
from tg4mm.core.regions import POINT_RADIUS, Pixel, Region, Regions, Scale
from tg4mm.show.regions import COLOURS

BOX, POLYGON, POINT, LENGTH, RECTANGLE = "box", "polygon", "point", "length", "rectangle"
TOOLS = {
    BOX: "Drag a box, or click two opposite corners.",
    POLYGON: "Click corners, then Finish.",
    POINT: "Click its middle.",
    LENGTH: "Give millimetres, then click both ends.",
    RECTANGLE: "Give width and height, then click its corners: upper left, upper right, lower right, lower left.",
}
_NEEDED = {BOX: 2, POINT: 1, LENGTH: 2, RECTANGLE: 4}
_EDGE = 10.0  # deviation over that of the best direction, from which the other counts as unresolved
_BOTH, _ONE = (60, 190, 90), (250, 190, 40)
_TINT = 0.35
_ALL, _HALF = 0.95, 0.5  # share of a cell inside a region


@dataclass(frozen=True)
class Drawing:
    """An immutable drawing on pictures of `size` (w, h), with the clicks of an unfinished shape."""

    size: Pixel
    regions: tuple[Region, ...] = ()
    scale: Scale | None = None
    tool: str = BOX
    clicks: tuple[Pixel, ...] = ()
    name: str = ""  # of the next region; "" for a number
    camera: str = ""
    sides_mm: Pixel = (0.0, 0.0)  # a length uses the first, a rectangle both
    before: "Drawing | None" = field(default=None, repr=False, compare=False)

    def taking(self, tool: str) -> "Drawing":
        """Return the drawing with another tool and without an unfinished shape."""
        return replace(self, tool=tool, clicks=())

    def clicked(self, at: Pixel) -> "Drawing":
        """Return the drawing with one more click, pixels. Raises Tg4mmError if it finishes an invalid shape."""
        inside = (min(max(at[0], 0.0), self.size[0]), min(max(at[1], 0.0), self.size[1]))
        more = replace(self, clicks=(*self.clicks, inside), before=self)
        return more.finished() if len(more.clicks) == _NEEDED.get(self.tool) else more

    def dragged(self, first: Pixel, last: Pixel) -> "Drawing":
        """Return the drawing with a box between corners, pixels. Raises Tg4mmError if invalid, or for another tool."""
        if self.tool != BOX:
            raise RegionError(
                f"a box is dragged with the tool {BOX}; {self.tool}: {TOOLS[self.tool].lower()}"
            )
        return replace(self.taking(BOX).clicked(first).clicked(last), before=self)

    def finished(self) -> "Drawing":
        """Return the drawing with a shape made of the clicks. Raises Tg4mmError if it is invalid."""
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


@dataclass(frozen=True)
class Texture:
    """The precision with which one picture determines each cell's shift."""

    grid: Grid
    information: np.ndarray  # [C, 2, 2] px⁻²; 0 where there is no texture

    def resolved(self) -> tuple[np.ndarray, np.ndarray]:
        """Return each cell's number of resolved directions [C], 0 to 2, and the better one [C, 2], right and down."""
        values, axes = np.linalg.eigh(self.information)
        least = np.maximum(values[:, 1] / _EDGE**2, LEAST_INFORMATION)
        return (values > least[:, None]).sum(1), axes[:, :, 1]

    def words(self, region: Region, size: tuple[int, int]) -> str:
        """Describe what can be measured in a region."""
        share = self.grid.cut(region.mask(size)[None])[:, 0].mean(1)
        cells = share >= (_ALL if (share >= _ALL).any() else _HALF)
        if not cells.any():
            return f"smaller than look's cells of {self.grid.size} px"
        count, _ = self.resolved()
        values, axes = np.linalg.eigh(self.information[cells & (count > 0)].sum(0))
        if not count[cells].any():
            return "no texture: nothing can be measured here"
        best = f"± {values[1] ** -0.5:.2g} px a picture"
        if values[0] > max(values[1] / _EDGE**2, LEAST_INFORMATION):
            return f"{best} along its best direction, ± {values[0] ** -0.5:.2g} px across it"
        right, down = axes[:, 1] * np.sign(axes[np.abs(axes[:, 1]).argmax(), 1])
        return f"an edge: {best} along {right:+.2f} right {-down:+.2f} up alone".replace("-", "−")


def texture_of(pictures: np.ndarray) -> Texture:
    """Compute the texture from the first pictures [F, H, W], float32 grey levels; their scatter gives the noise."""
    height, width = pictures.shape[1:]
    grid = Grid.of(width, height, min(CELL, height, width))
    covariance = Template(pictures.mean(0, dtype=np.float32), grid).covariance
    noise = np.full(len(grid), QUANTISED)
    if len(pictures) > 1:  # neighbours differ by twice the variance
        noise = np.maximum(
            np.median((np.diff(grid.cut(pictures), axis=1) ** 2).mean(2) / 2, axis=1), QUANTISED
        )
    false = false_information(grid.size) / len(pictures)
    information = np.linalg.inv(covariance * noise[:, None, None] + 1e-12 * np.eye(2)) - false * np.eye(2)
    values, axes = np.linalg.eigh(information)
    values = np.where(values > max(LEAST_INFORMATION, FROZEN * false), values, 0.0)
    return Texture(grid, np.einsum("cik,ck,cjk->cij", axes, values, axes))


def drawn(picture: np.ndarray, drawing: Drawing, texture: Texture | None, scale: float = 1.0) -> np.ndarray:
    """Return a picture [H, W, 3] with texture, regions and marks as [H·scale, W·scale, 3] uint8.

    Green cells resolve both directions, amber ones only that of their stroke, others none.
    """
    shown = picture.astype(np.float32)
    resolved, axes = (np.zeros(0, int), np.zeros((0, 2))) if texture is None else texture.resolved()
    if texture is not None:
        size = texture.grid.size
        for count, colour in ((1, _ONE), (2, _BOTH)):
            cells = np.kron(texture.grid.picture(resolved == count), np.ones((size, size), bool))
            part = shown[: cells.shape[0], : cells.shape[1]]
            part[cells] = (1 - _TINT) * part[cells] + _TINT * np.array(colour)
    height, width = round(picture.shape[0] * scale), round(picture.shape[1] * scale)
    image = Image.fromarray(shown.astype(np.uint8)).resize((max(width, 1), max(height, 1)))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(max(13, round(min(image.size) / 32)))
    if texture is not None:
        for (x, y), (right, down) in zip(
            texture.grid.centres()[resolved == 1], axes[resolved == 1], strict=True
        ):
            reach = 0.4 * texture.grid.size
            ends = (x - reach * right, y - reach * down), (x + reach * right, y + reach * down)
            draw.line([_at(end, scale) for end in ends], fill=_ONE, width=2)
    for k, region in enumerate(drawing.regions):
        if region.camera == drawing.camera:
            colour = COLOURS[k % len(COLOURS)]
            corners = [_at(corner, scale) for corner in region.corners]
            draw.line([*corners, corners[0]], fill=colour, width=3, joint="curve")
            _write(draw, corners[0], region.name, font)
    if drawing.scale is not None:
        for a, b, metres in drawing.scale.lengths:
            draw.line([_at(a, scale), _at(b, scale)], fill=(255, 255, 255), width=3)
            _write(draw, _at(b, scale), f"{1e3 * metres:.4g} mm", font)
        if corners := [_at(corner, scale) for corner in drawing.scale.corners]:
            draw.line([*corners, corners[0]], fill=(255, 255, 255), width=2)
            width_m, height_m = drawing.scale.sides_m
            _write(draw, corners[0], f"{1e3 * width_m:.4g} × {1e3 * height_m:.4g} mm", font)
    _clicks(draw, [_at(at, scale) for at in drawing.clicks])
    return np.asarray(image)


def _at(place: Sequence[float] | np.ndarray, scale: float) -> tuple[float, float]:
    return float(place[0] * scale), float(place[1] * scale)


def _clicks(draw: ImageDraw.ImageDraw, places: Sequence[tuple[float, float]]) -> None:
    if len(places) > 1:
        draw.line(list(places), fill=(255, 60, 60), width=2)
    for x, y in places:
        draw.ellipse((x - 5, y - 5, x + 5, y + 5), outline=(255, 60, 60), width=2)


def _write(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, font: Any) -> None:
    draw.text(
        (at[0] + 5, at[1] + 4), text, font=font, fill=(255, 255, 255), stroke_width=2, stroke_fill=(0, 0, 0)
    )
