"""Operators and panels as functions: the decorators here make the classes that Blender registers."""

import functools
from collections.abc import Callable
from typing import Any

import bpy

from tg4mm.core.errors import Tg4mmError

from .nodes import scene

Function = Callable[..., Any]
Execute = Callable[[Any, Any], set[str]]
TAB = "VIEW3D_PT_tg4mm"  # the panel that the others of a splat object belong to


def one_line(error: OSError, done: str) -> str:
    """Return the message for a system error: the file, what failed, and why."""
    return f"{error.filename or 'a file'}: cannot be {done}: {error.strerror or error}"


def reports(done: str = "used") -> Callable[[Execute], Execute]:
    """Let `execute` report bad input and files that cannot be `done` in one line, and cancel."""

    def decorate(execute: Execute) -> Execute:
        @functools.wraps(execute)
        def reported(operator: Any, context: Any) -> set[str]:
            try:
                return execute(operator, context)
            except Tg4mmError as error:
                message = str(error)
            except OSError as error:
                message = one_line(error, done)
            operator.report({"ERROR"}, message)
            return {"CANCELLED"}

        return reported

    return decorate


def on_splats(context: Any) -> bool:
    """Return whether the active object is a splat object."""
    return scene.splat_object(context) is not None


def on_motion(context: Any) -> bool:
    """Return whether the active object is a splat object with modes of motion."""
    return scene.moves(scene.splat_object(context))


class Declared:
    """The classes that a module declares, in the order of its functions."""

    def __init__(self) -> None:
        self.classes: list[Any] = []

    def operator(
        self,
        label: str,
        poll: Function | None = None,
        undo: bool = True,
        about: Function | None = None,
        draw: Function | None = None,
        **properties: Any,
    ) -> Callable[[Function], Function]:
        """Make `function(operator, context)` the operator tg4mm.<its name>, its docstring the tooltip.

        A message that the function returns is reported; it may raise Tg4mmError or OSError. `poll(context)`: whether it
        can run; `about(context, properties)`: the tooltip where that depends on the properties;
        `draw(operator, context)`: the settings where not all are shown.
        """

        def decorate(function: Function) -> Function:
            @reports()
            def execute(operator: Any, context: Any) -> set[str]:
                if message := function(operator, context):
                    operator.report({"INFO"}, message)
                return {"FINISHED"}

            body: dict[str, Any] = {
                "__doc__": function.__doc__, "__annotations__": properties, "execute": execute,
                "bl_idname": f"tg4mm.{function.__name__}", "bl_label": label,
            }  # fmt: skip
            if undo:
                body["bl_options"] = {"REGISTER", "UNDO"}
            if poll is not None:
                body["poll"] = classmethod(lambda cls, context: bool(poll(context)))
            if about is not None:
                body["description"] = classmethod(lambda cls, context, given: about(context, given))
            if draw is not None:
                body["draw"] = draw
            self.classes.append(type(f"TG4MM_OT_{function.__name__}", (bpy.types.Operator,), body))
            return function

        return decorate

    def panel(
        self,
        idname: str,
        label: str,
        poll: Function | None = None,
        parent: str = "",
        closed: bool = False,
        order: int | None = None,
    ) -> Callable[[Function], Function]:
        """Make `function(layout, context)` the panel `idname` in the tab TG4MM of the 3D view's sidebar."""

        def decorate(function: Function) -> Function:
            body: dict[str, Any] = {
                "__doc__": function.__doc__, "draw": lambda panel, context: function(panel.layout, context),
                "bl_idname": idname, "bl_label": label, "bl_space_type": "VIEW_3D", "bl_region_type": "UI",
                "bl_category": "TG4MM", "bl_options": {"DEFAULT_CLOSED"} if closed else set(),
            }  # fmt: skip
            if parent:
                body["bl_parent_id"] = parent
            if order is not None:
                body["bl_order"] = order
            if poll is not None:
                body["poll"] = classmethod(lambda cls, context: bool(poll(context)))
            self.classes.append(type(idname, (bpy.types.Panel,), body))
            return function

        return decorate

    def register(self) -> None:
        for cls in self.classes:
            bpy.utils.register_class(cls)

    def unregister(self) -> None:
        for cls in reversed(self.classes):
            bpy.utils.unregister_class(cls)
