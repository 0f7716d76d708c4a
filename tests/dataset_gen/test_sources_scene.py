"""A user's .blend file as a whole: libraries, which scene, its size, refusals, and the same in every process."""

import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix  # noqa: E402

from dataset_gen.errors import GenerateError  # noqa: E402
from dataset_gen.sources import open_blend  # noqa: E402
from tests.dataset_gen.sources_blends import (  # noqa: E402
    bodies_of,
    emission,
    link,
    mesh_of,
    new_scene,
    save,
    tetrahedron,
)


def test_objects_of_a_linked_library_are_taken_and_a_lost_library_is_named(tmp_path):
    new_scene()
    obj = link("bolt", tetrahedron())
    obj.data.materials.append(emission("steel", lambda tree: tree.nodes.new("ShaderNodeTexNoise").outputs[0]))
    library = save(tmp_path, "parts.blend")
    new_scene()
    with bpy.data.libraries.load(str(library), link=True) as (source, target):
        target.objects = source.objects
    link("own", tetrahedron())
    bpy.context.scene.collection.objects.link(target.objects[0])
    user = save(tmp_path)
    loaded = open_blend(user)
    assert set(bodies_of(loaded)) == {"own", "bolt"}
    assert not bpy.data.libraries
    assert all(obj.library is None and obj.data.library is None for obj in loaded.stage.objects)
    library.unlink()
    loaded = open_blend(user)
    assert set(bodies_of(loaded)) == {"own"}
    assert any("parts.blend is missing" in line for line in loaded.warnings)


def test_the_sphere_around_the_scene_leaves_a_wide_floor_out(tmp_path):
    new_scene()
    link("part", tetrahedron())
    loaded = open_blend(save(tmp_path, "a.blend"))
    assert np.allclose(loaded.centre, (0.5, 1.0, 1.5))
    assert np.isclose(loaded.radius, np.sqrt(0.25 + 1 + 2.25))
    link("floor", mesh_of("floor", [(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], [(0, 1, 2, 3)]))
    wide = open_blend(save(tmp_path, "b.blend"))
    assert (wide.centre, wide.radius) == (loaded.centre, loaded.radius)
    assert set(bodies_of(wide)) == {"part", "floor"}
    assert any("without floor" in line for line in wide.warnings)


def test_a_scene_of_which_nothing_renders_is_one_line(tmp_path):
    new_scene()
    link("part", tetrahedron()).hide_render = True
    with pytest.raises(
        GenerateError, match=r"user\.blend: nothing in scene 'Scene' is a surface that renders"
    ):
        open_blend(save(tmp_path))


def test_vertices_that_are_no_places_are_one_line(tmp_path):
    new_scene()
    mesh = tetrahedron()
    mesh.vertices[2].co.y = float("nan")
    link("broken", mesh)
    with pytest.raises(GenerateError, match=r"object broken: vertex 2 lies at \[0\.0, nan, 0\.0\]"):
        open_blend(save(tmp_path))


def test_the_scene_is_the_active_one_or_the_named_one(tmp_path):
    new_scene()
    link("part", tetrahedron())
    other = bpy.data.scenes.new("other")
    link("second", tetrahedron(), other)
    path = save(tmp_path)
    loaded = open_blend(path)
    assert [body.name for body in loaded.bodies] == ["part"]
    assert any("the file also holds other" in line for line in loaded.warnings)
    assert [body.name for body in open_blend(path, scene="other").bodies] == ["second"]
    with pytest.raises(GenerateError, match="holds no scene 'third': there is Scene, other"):
        open_blend(path, scene="third")


def test_opening_is_the_same_in_every_process(tmp_path):
    new_scene()
    for i in range(5):
        obj = link(f"part {i}", tetrahedron(), matrix=Matrix.Translation((i, 0, 0)))
        obj.instance_type = "NONE"
    path = save(tmp_path)
    program = (
        "import sys, hashlib; from pathlib import Path; from dataset_gen.sources import open_blend\n"
        "loaded = open_blend(Path(sys.argv[1]))\n"
        "content = b''.join(b.name.encode() + b.vertices.tobytes() for b in loaded.bodies)\n"
        "print('digest', hashlib.sha256(content).hexdigest())"
    )
    runs = [
        subprocess.run(
            [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    digests = [[line for line in run.splitlines() if line.startswith("digest")] for run in runs]
    assert digests[0]
    assert digests[0] == digests[1]
