"""A .glb taken apart by the definition of its container."""

import json
import struct

import numpy as np


def parsed(path):
    """(JSON, {attribute: array}) of a .glb, by the container's own definition."""
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sII I4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    chunk, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert (kind, chunk) == (b"BIN\0", document["buffers"][0]["byteLength"])
    binary = data[28 + length :]

    def array(number):
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        flat = np.frombuffer(binary, "<f4", accessor["count"] * width, view["byteOffset"])
        return flat.reshape(-1, width)

    return document, array
