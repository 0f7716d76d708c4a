"""Splats as files of other formats (docs/export.md): glTF, SPZ, USD. Each writer takes a SplatFile."""
