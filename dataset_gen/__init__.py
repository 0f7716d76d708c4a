"""Dataset generator: scenes that vibrate, rendered by Blender's Cycles, with exact truth of the motion."""
