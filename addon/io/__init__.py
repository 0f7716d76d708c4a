"""Files in and out: from chosen paths to objects, text to files."""
