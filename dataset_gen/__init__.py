"""Dataset generator: scenes that vibrate, rendered by Blender's Cycles, with exact truth of the motion.

Pure numpy: `settings`, `vibration`, `cameras`, `meshes`, `textures`, `scene`, `scenes`, `plan`, `tree`, `points`.
Inside Blender (bpy): `build`, `render`, `compat`, `worker`. Nothing here imports torch.
"""
