"""Pictures and videos of a run: from its test cameras, from a file of cameras, or on an orbit."""
