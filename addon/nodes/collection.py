"""Which collection takes a new object: the active one, unless what is in it cannot be seen or added to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


def receiving(context: Any) -> Any:
    """The context's collection; if it is excluded, hidden or linked, the nearest above it that is none of these.

    The scene's own collection if there is no such, or if the collection is not in the view layer.
    """
    context.view_layer.update()  # Blender may not have worked out yet what is visible
    wanted = context.collection
    ways = [way for way in _ways(context.view_layer.layer_collection) if way[-1].collection == wanted]
    for way in ways:  # a collection may be in several others, and be seen in one of them alone
        if _takes(way[-1]):
            return wanted
    for way in ways:
        for layer in reversed(way):
            if _takes(layer):
                return layer.collection
    return context.scene.collection


def _takes(layer: Any) -> bool:
    """Whether an object that is linked to a layer's collection is seen."""
    if layer.exclude or not layer.is_visible:
        return False
    return layer.collection.library is None and layer.collection.override_library is None


def _ways(layer: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every layer collection with those it lies in, from the outermost."""
    way = (*above, layer)
    yield way
    for child in layer.children:
        yield from _ways(child, way)
