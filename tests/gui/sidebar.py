"""The sidebar's tab TG4MM by mouse: opening it, finding its controls, importing a file through the menu.

Blender tells no one where a button is, so the pointer is led down the panel and Blender's own shortcut copies what
lies under it: the data path of a value (Ctrl Shift Alt C).
"""

import time

from .session import ACTIVE, OBJECTS, SessionError

TAB = "TG4MM"
TAB_STEP, ROW_STEP = 24, 18  # pixels; less than a tab and a row are high


def open_tab(blender):
    """N over the view, then click down the tabs until Blender says that ours is the one."""
    blender.move(*blender.region("VIEW_3D").middle)
    if not blender.ask("tab"):
        blender.key("n")
        blender.wait(lambda: blender.ask("tab") != "", "the sidebar")
    box = blender.region("VIEW_3D", "UI")
    for y in range(box.top + TAB_STEP // 2, box.top + box.height, TAB_STEP):
        blender.click(box.left + box.width - 9, y)
        if _soon(lambda: blender.ask("tab") == TAB, 1.5):
            return
    raise SessionError(f"the sidebar has no tab {TAB}\n{blender.log()}")


def find(blender, name, at=0.55):
    """Where the control of an input of the active object's modifier is, among what is in sight.

    `at`: where in a row it is looked for, 0 on the left edge of the sidebar and 1 on the right. Over a header or label
    Blender copies the path of the value that the pointer was over last. So a path counts only where the value itself
    can be copied too, which takes a pointer over it, or once another path was met in this search.
    """
    path, box = blender.ask("paths")[name], blender.region("VIEW_3D", "UI")
    x, met = box.left + round(at * box.width), False
    for y in range(box.top + 10, box.top + box.height - 6, ROW_STEP):
        found = under_pointer(blender, x, y)
        if not found.endswith(path):
            met |= found != ""
        elif met or under_pointer(blender, x, y, "ctrl+c"):
            return x, y
    raise SessionError(f"no control for {name} in the sidebar\n{blender.log()[-2000:]}")


def find_button(blender, command, at=0.55):
    """Where the button in sight is that runs a command, such as `tg4mm.band(frequency=5`."""
    box = blender.region("VIEW_3D", "UI")
    x = box.left + round(at * box.width)
    for y in range(box.top + 10, box.top + box.height - 6, ROW_STEP):
        if command in under_pointer(blender, x, y, "ctrl+c"):
            return x, y
    raise SessionError(f"no button for {command} in the sidebar\n{blender.log()[-2000:]}")


def under_pointer(blender, x, y, keys="ctrl+shift+alt+c"):
    """Data path of the value under the pointer, with ctrl+c the value itself; empty where there is none."""
    blender.value("setattr(bpy.context.window_manager, 'clipboard', '')")  # without a redraw
    blender.key_at(x, y, keys)
    return str(blender.value("bpy.context.window_manager.clipboard"))


def drag_value(blender, name, pixels):
    """Drag a number field sideways; returns the value then."""
    before = blender.ask("inputs")[name]
    blender.drag(find(blender, name), (pixels, 0))
    if not _soon(lambda: blender.ask("inputs")[name] != before, 30.0):
        raise SessionError(f"dragging {name} by {pixels} pixels left it at {before}")
    return float(blender.ask("inputs")[name])


def import_by_menu(blender, file, wait=30.0):
    """File > Import > TG4MM Splats, the file's path in the file browser; returns the new object's name."""
    before = set(blender.value(OBJECTS))
    blender.click(42, 14)
    time.sleep(0.5)
    blender.key("space")  # the menu's search
    blender.write("Import TG4MM Splats")
    time.sleep(0.5)
    blender.key("Return")
    blender.wait(lambda: blender.ask("chosen_file") != "", "the file browser")
    time.sleep(0.5)
    blender.move(*blender.region("FILE_BROWSER").middle)
    blender.key("ctrl+l", "ctrl+a")
    blender.write(f"{blender.inside}/{file}")
    blender.key("Return")
    blender.wait(lambda: blender.ask("chosen_file") == f"{blender.inside}/{file}", "the path to be taken")
    box = blender.region("FILE_BROWSER", "EXECUTE")
    for _ in range(3):  # where the path's field still has the keyboard, the first click only takes it away
        blender.click(box.left + box.width - 60, box.top + box.height // 2 - 2)
        if _soon(lambda: blender.ask("chosen_file") == "", 2.0):
            break
    blender.wait(lambda: len(blender.value(OBJECTS)) > len(before), f"an object of {file}", wait)
    return str(blender.value(f"{ACTIVE}.name"))


def _soon(condition, limit):
    """True once the condition holds, False if it does not in `limit` seconds."""
    ends = time.monotonic() + limit
    while time.monotonic() < ends:
        if condition():
            return True
        time.sleep(0.05)
    return condition()
