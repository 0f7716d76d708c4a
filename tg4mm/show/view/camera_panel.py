"""Cameras of the capture to jump to. Every page has a camera of its own; the one who asks jumps."""

from __future__ import annotations

from typing import Any

import viser

from tg4mm.show.view.cameras import Standpoint, middle_depth, standpoint_of
from tg4mm.show.view.session import Session

_BEFORE, _AGAIN, _NEXT = "previous", "back to it", "next"


class CameraPanel:
    """A list of cameras, and buttons to step through it."""

    def __init__(self, server: viser.ViserServer, session: Session, folder: viser.GuiFolderHandle) -> None:
        self._session = session
        self._cameras = session.scene.cameras
        self._names = tuple(camera.name for camera in self._cameras)
        with folder:
            hint = "Of the capture. The page jumps there."
            self._list: Any = server.gui.add_dropdown("Camera", self._names, hint=hint)
            steps = server.gui.add_button_group("Step", (_BEFORE, _AGAIN, _NEXT))
        self._list.on_update(lambda event: self.jump(event.client, self._chosen()))
        steps.on_click(lambda event: self._step(event.client, str(steps.value)))

    def _chosen(self) -> int:
        return self._names.index(self._list.value)

    def _step(self, client: viser.ClientHandle | None, name: str) -> None:
        i = (self._chosen() + {_BEFORE: -1, _AGAIN: 0, _NEXT: 1}[name]) % len(self._names)
        self._list.value = self._names[i]
        self.jump(client, i)

    def jump(self, client: viser.ClientHandle | None, i: int) -> None:
        """Put a page's camera where camera `i` of the capture stood, with all of its picture in view.

        None, where the list was moved from here, moves no one.
        """
        if client is None:
            return
        scene = self._session.scene
        depth = middle_depth(scene.gaussians.means.numpy(), scene.weights, self._cameras[i])
        place(client, standpoint_of(self._cameras[i], depth, client.camera.aspect))


def place(client: viser.ClientHandle, to: Standpoint) -> None:
    """Move a page's camera there at once."""
    with client.atomic():
        client.camera.up_direction = to.up
        client.camera.position = to.position
        client.camera.look_at = to.target
        client.camera.fov = to.fov
