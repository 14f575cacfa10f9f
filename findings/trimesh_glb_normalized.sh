#!/usr/bin/env bash
# trimesh 5.2.0: GLB positions stored as normalized 16-bit integers are taken as metres times 32767, and triangle fans vanish.
# Source: glTF 2.0, section 3.6.2.2, and KHR_mesh_quantization, run on 2026-11-29. Remedy: dequantize before loading, for instance with glTF-Transform.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import io
import json
import logging
import struct

import numpy as np
import trimesh

logging.captureWarnings(True)
logging.basicConfig(level=logging.WARNING, format="  logged: %(message)s")


def load(positions, indices, *, normalized, mode=4):
    """Return the mesh that trimesh reads from a GLB with one primitive; integer rows are padded to 4-byte multiples, as glTF asks."""
    integer = positions.dtype == np.int16
    rows = np.pad(positions, ((0, 0), (0, 1))) if integer else positions
    first, second = rows.tobytes(), indices.astype(np.uint16).tobytes()
    view = {"buffer": 0, "byteOffset": 0, "byteLength": len(first), "byteStride": rows.strides[0], "target": 34962}
    accessor = {"bufferView": 0, "componentType": 5122 if integer else 5126, "count": len(rows), "type": "VEC3"}
    accessor |= {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()} | ({"normalized": True} if normalized else {})
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
        "accessors": [accessor, {"bufferView": 1, "componentType": 5123, "count": indices.size, "type": "SCALAR"}],
        "bufferViews": [view, {"buffer": 0, "byteOffset": len(first), "byteLength": len(second), "target": 34963}],
        "buffers": [{"byteLength": len(first) + len(second)}],
    }
    if integer:
        header["extensionsUsed"] = header["extensionsRequired"] = ["KHR_mesh_quantization"]
    text, body = json.dumps(header).encode(), first + second
    text, body = text + b" " * (-len(text) % 4), body + b"\0" * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    return trimesh.load(io.BytesIO(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks), file_type="glb").to_mesh()


box = trimesh.creation.box((0.06, 0.04, 0.02))
plain = load(box.vertices.astype(np.float32), box.faces, normalized=False)
packed = load(np.round(box.vertices * 32767).astype(np.int16), box.faces, normalized=True)
square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
strip = load(square[[0, 1, 3, 2]], np.arange(4), normalized=False, mode=5)
fan = load(square, np.arange(4), normalized=False, mode=6)
print(f"trimesh {trimesh.__version__}; first seen 2026-11-29")
print("one would expect: both boxes 0.06 x 0.04 x 0.02 m, as the format's max(c / 32767, -1) gives, or an error: the file requires the extension;")
print("                  the square as a triangle strip and as a fan: area 1 and 1")
print(f"what happens:     float positions {plain.extents.round(4)}, normalized int16 positions {packed.extents.round(1)}, no error")
print(f"                  strip: {len(strip.faces)} triangles, area {strip.area:.1f}; fan: {len(fan.faces)} triangles, area {fan.area:.1f}")
print("so:               a compressed asset is 32767 times too large, and one drawn with fans lacks faces: check sizes after loading")
assert np.allclose(plain.extents, box.extents, atol=1e-6) and np.isclose(strip.area, 1), "the plain files should be read rightly"
assert np.allclose(packed.extents, [1966, 1310, 656], atol=1) and len(fan.faces) == 0, "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py"
