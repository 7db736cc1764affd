#!/usr/bin/env bash
# Guess: gltfpack keeps an animation of morph targets, to its quantisation: glTF gives weights no range, and a track from -1 to 2
# is valid (exaggerated or reversed expressions, corrective shapes, components of a principal component analysis).
#
# Seen instead: weights are stored as normalised bytes, so that -1 becomes 0 and 2 becomes 1, without a warning, even with
# -noq, which turns quantisation off.
#
# Why it matters: a packed motion of signed weights moves with its backward halves missing. Shift and scale targets so that
# weights stay between 0 and 1 before packing.
#
# Versions: gltfpack 0.24.0.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y > /dev/null
npm install --silent gltfpack@0.24.0
cat > make.py <<'PYTHON'
import json
import struct

TRIANGLE = (0, 0, 0, 1, 0, 0, 0, 1, 0)
UP = (0, 0, 1) * 3
TIMES = (0, 1)
WEIGHTS = (-1, 2)
parts = [struct.pack(f"<{len(row)}f", *row) for row in (TRIANGLE, UP, TIMES, WEIGHTS)]
content = b"".join(parts)
views, offset = [], 0
for part in parts:
    views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part)})
    offset += len(part)
accessors = [
    {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
    {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 1], "max": [0, 0, 1]},
    {"bufferView": 2, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
    {"bufferView": 3, "componentType": 5126, "count": 2, "type": "SCALAR"},
]
document = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 1}]}], "weights": [0]}],
    "animations": [
        {
            "samplers": [{"input": 2, "output": 3}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
        }
    ],
    "buffers": [{"byteLength": len(content)}],
    "bufferViews": views,
    "accessors": accessors,
}
text = json.dumps(document).encode()
text += b" " * (-len(text) % 4)
with open("in.glb", "wb") as file:
    file.write(struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(content)))
    file.write(struct.pack("<II", len(text), 0x4E4F534A) + text)
    file.write(struct.pack("<II", len(content), 0x004E4942) + content)
PYTHON
cat > read.py <<'PYTHON'
import json
import struct
import sys


def weights_of(path):
    with open(path, "rb") as file:
        whole = file.read()
    (length,) = struct.unpack_from("<I", whole, 12)
    document = json.loads(whole[20 : 20 + length])
    animation = document["animations"][0]
    accessor = document["accessors"][animation["samplers"][animation["channels"][0]["sampler"]]["output"]]
    start = 28 + length + accessor.get("byteOffset", 0)
    start += document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    if accessor["componentType"] == 5121:
        return [byte / 255 for byte in whole[start : start + accessor["count"]]]
    return list(struct.unpack_from(f"<{accessor['count']}f", whole, start))


given, packed, unquantised = (weights_of(path) for path in ("in.glb", "packed.glb", "noq.glb"))
for name, weights in (("given", given), ("packed", packed), ("packed with -noq", unquantised)):
    print(f"{name}: weights from {min(weights):.2f} to {max(weights):.2f}")
is_as_seen = given == [-1, 2] and all((min(w), max(w)) == (0, 1) for w in (packed, unquantised))
sys.exit(0 if is_as_seen else "This has changed: look at what gltfpack does now.")
PYTHON
python3 make.py
echo "gltfpack $(node -p 'require("gltfpack/package.json").version')"
npx gltfpack -i in.glb -o packed.glb
npx gltfpack -noq -i in.glb -o noq.glb
python3 read.py
