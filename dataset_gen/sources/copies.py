"""The user's materials and world as copies that can be rendered anywhere, and what was changed in them."""

from collections.abc import Callable, Iterable

import bpy

from ..build import trees
from ..build import world as made_world
from ..scene import Gradient
from .images import Anchors, list_names, own_groups, repair_images

_SUFFIX = " tg4mm"  # of our copies of materials while the originals are there
SKY = Gradient(((0.35, 0.34, 0.33), (0.7, 0.7, 0.7), (1.0, 1.0, 1.0)))  # of scenes without any light
# Where a node says how much light it gives.
_STRENGTH = {
    "ShaderNodeBackground": "Strength",
    "ShaderNodeEmission": "Strength",
    "ShaderNodeBsdfPrincipled": "Emission Strength",
}


class MaterialCopies:
    """Our own copies of the user's materials, repaired and anchored; each is made when it is asked for."""

    def __init__(self, anchors: Anchors, warnings: list[str]) -> None:
        self._anchors, self._warnings = anchors, warnings
        self._made: dict[bpy.types.Material | None, bpy.types.Material | None] = {}
        self._groups: dict[bpy.types.NodeTree, bpy.types.NodeTree] = {}
        self._anchored: set[bpy.types.NodeTree] = set()
        self._displaced: set[str] = set()
        self._volumes: set[str] = set()
        self._lost: set[str] = set()

    def material(self, original: bpy.types.Material | None) -> bpy.types.Material | None:
        """The copy to be used. None if the material is a volume without a surface."""
        if original not in self._made:
            self._made[original] = _plain("tg4mm grey") if original is None else self._copy(original)
        return self._made[original]

    @property
    def made(self) -> list[bpy.types.Material]:
        return [material for material in self._made.values() if material is not None]

    def _copy(self, original: bpy.types.Material) -> bpy.types.Material | None:
        material = original.copy()
        material.name = f"{original.name}{_SUFFIX}"
        material.animation_data_clear()
        if not has_nodes(material) or material.node_tree is None:
            _from_viewport(material)
        elif any(tree.is_missing for tree in trees([material.node_tree])):
            _from_viewport(material)
            self._lost.add(original.name)
        tree = material.node_tree
        tree.animation_data_clear()
        own_groups(tree, self._groups)
        for each in trees([tree]):
            if each not in self._anchored:
                self._anchored.add(each)
                self._anchors.rewrite(each)
        output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
        if output is None:
            return material
        if not self._only_a_surface(tree, output, original.name):
            return None
        if output.inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
            material.displacement_method = "BUMP"
            self._displaced.add(original.name)
        return material

    def _only_a_surface(self, tree: bpy.types.NodeTree, output: bpy.types.Node, name: str) -> bool:
        volume = output.inputs["Volume"]
        if volume.is_linked:
            self._volumes.add(name)
            for link in list(volume.links):
                tree.links.remove(link)
            return bool(output.inputs["Surface"].is_linked)
        return True

    def rename(self) -> None:
        """Gives the copies the names of the originals, once these are gone."""
        for material in bpy.data.materials:
            material.name = material.name.removesuffix(_SUFFIX)

    def report(self) -> None:
        """Adds the warnings about all materials that were made."""
        self._warnings += repair_images(trees(m.node_tree for m in self.made))
        for names, text in (
            (self._lost, "some nodes are missing with their library, replaced by a plain colour"),
            (self._displaced, "displacement is rendered as a bump, which ground truth ignores"),
            (self._volumes, "volumes are left out"),
            (
                using(self.made, _transparent),
                "ground truth treats transparent parts as opaque surface",
            ),
            (
                using(self.made, _glassy),
                "ground truth is that of the glass surface, not of what lies behind it",
            ),
        ):
            if names:
                self._warnings.append(f"materials {list_names(names)}: {text}")
        if self._anchors.unanchored:
            self._warnings.append(
                f"materials read {list_names(self._anchors.unanchored)}: what that gives may differ"
            )


def _plain(name: str) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    _from_viewport(material)
    return material


def has_nodes(block: bpy.types.Material | bpy.types.World) -> bool:
    """Return whether the material uses nodes; from Blender 5.0 on it always does."""
    return bpy.app.version >= (5, 0, 0) or bool(block.use_nodes)


def _from_viewport(material: bpy.types.Material) -> None:
    """A Principled shader with the colour that the viewport shows: of files without nodes."""
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfPrincipled"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    shader.inputs["Base Color"].default_value = (*material.diffuse_color[:3], 1.0)
    shader.inputs["Metallic"].default_value = material.metallic
    shader.inputs["Roughness"].default_value = material.roughness


def using(materials: Iterable[bpy.types.Material], test: Callable[[bpy.types.Node], bool]) -> set[str]:
    """Names of the materials with a node, in groups too, that passes the test."""
    return {
        material.name.removesuffix(_SUFFIX)
        for material in materials
        if any(test(node) for tree in trees([material.node_tree]) for node in tree.nodes)
    }


def above(node: bpy.types.Node, socket: str, least: float = 0.0) -> bool:
    """Return whether a socket is linked or its value exceeds a number."""
    found = node.inputs.get(socket)
    return found is not None and (found.is_linked or found.default_value > least)


def _transparent(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        alpha = node.inputs["Alpha"]
        return bool(alpha.is_linked or alpha.default_value < 1.0)
    return node.bl_idname == "ShaderNodeBsdfTransparent" and bool(node.outputs[0].links)


def _glassy(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        return above(node, "Transmission Weight")
    return node.bl_idname in ("ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction") and bool(
        node.outputs[0].links
    )


def own_world(scene: bpy.types.Scene, lit: bool, warnings: list[str]) -> bpy.types.World:
    """The scene's world as a copy with nodes; a grey sky instead if there is no other light at all."""
    world = scene.world.copy() if scene.world else None
    if world is not None:
        world.animation_data_clear()
        if not has_nodes(world) or world.node_tree is None:
            _world_from_colour(world)
        world.node_tree.animation_data_clear()
        own_groups(world.node_tree, {})
        warnings += repair_images(trees([world.node_tree]))
        output = world.node_tree.get_output_node("CYCLES") or world.node_tree.get_output_node("ALL")
        if output is not None and output.inputs["Volume"].is_linked:
            world.node_tree.links.remove(output.inputs["Volume"].links[0])
            warnings.append(f"world {scene.world.name}: its volume is left out")
        if lit or any(_shines(node) for tree in trees([world.node_tree]) for node in tree.nodes):
            return world
    elif lit:
        world = bpy.data.worlds.new("black")
        world.color = (0.0, 0.0, 0.0)
        _world_from_colour(world)
        return world
    warnings.append("the file holds no light at all: a grey sky lights it")
    return made_world(SKY)


def _world_from_colour(world: bpy.types.World) -> None:
    colour = tuple(world.color)
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (*colour, 1.0)
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])


def _shines(node: bpy.types.Node) -> bool:
    if node.bl_idname not in ("ShaderNodeBackground", "ShaderNodeEmission") or not node.outputs[0].links:
        return False
    colour = node.inputs["Color"]
    return above(node, "Strength") and (colour.is_linked or any(colour.default_value[:3]))


def glows(materials: Iterable[bpy.types.Material]) -> bool:
    """Return whether any of the materials emits light."""
    return bool(using(materials, _glows))


def _glows(node: bpy.types.Node) -> bool:
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        colour = node.inputs["Emission Color"]
        black = not colour.is_linked and not any(colour.default_value[:3])
        return above(node, "Emission Strength") and not black
    return node.bl_idname == "ShaderNodeEmission" and bool(node.outputs[0].links) and above(node, "Strength")


def brighten(all_trees: Iterable[bpy.types.NodeTree], factor: float) -> None:
    """Makes all that gives light in the trees brighter by a factor; a world or material, not a lamp's."""
    for tree in all_trees:
        for node in list(tree.nodes):
            strength = node.inputs.get(_STRENGTH.get(node.bl_idname, ""))
            if strength is None:
                continue
            if not strength.is_linked:
                strength.default_value *= factor
                continue
            scaled = tree.nodes.new("ShaderNodeMath")
            scaled.operation = "MULTIPLY"
            tree.links.new(strength.links[0].from_socket, scaled.inputs[0])
            scaled.inputs[1].default_value = factor
            tree.links.new(scaled.outputs[0], strength)
