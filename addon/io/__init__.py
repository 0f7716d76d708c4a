"""Import and export: chosen files to Blender objects, and objects to files."""
