"""Changes to the JSON of a GLB file as a tree, with lengths that are right again."""

from __future__ import annotations

import random

from fuzz import mutate_json

DICTIONARY = (
    b'"bufferView"', b'"count":', b'"byteStride":', b'"sparse":{', b'"matrix":[', b'"children":[',
    b'"KHR_draco_mesh_compression"', b"5126", b'"VEC3"', b'"MAT4"', b'"mode":5', b'"JOINTS_15"',
    b"4294967295", b"1e999", b"NaN", b"data:application/octet-stream;base64,",
)  # fmt: skip


def mutate_json_chunk(data: bytes, rng: random.Random) -> bytes:
    """Return the file with its JSON changed; what is no GLB file as it is."""
    if len(data) < 20 or not data.startswith(b"glTF"):
        return data
    end = 20 + int.from_bytes(data[12:16], "little")
    text = mutate_json.mutate(data[20:end].rstrip(), rng)
    text += b" " * (-len(text) % 4)
    content = len(text).to_bytes(4, "little") + b"JSON" + text + data[end:]
    return b"glTF" + data[4:8] + (12 + len(content)).to_bytes(4, "little") + content
