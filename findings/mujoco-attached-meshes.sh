#!/bin/sh
# MuJoCo writes a model that attaches another without the folder of the attached one's meshes.
#
# Guess: what MjSpec.to_xml() writes, MuJoCo reads again from the same folder.
# Seen: a model whose <model file="../hand/hand.xml"/> has its own meshdir compiles; the text written from it names the
# attached mesh by its bare file name, under the meshdir of the outer model, and cannot be compiled: "Error opening file".
# Matters: to_xml() is the usual advice for "write one model", and each robot of a menagerie has its own meshdir.
# Versions: mujoco 3.17.0, Python 3.11.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet mujoco==3.17.0
cd "$work"
venv/bin/python - <<'PYTHON'
import struct
from pathlib import Path

import mujoco

CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
triangles = [[0, 0, 0, *(x for corner in face for x in CORNERS[corner]), 0] for face in FACES]
stl = bytes(80) + struct.pack("<I", 4) + b"".join(struct.pack("<12fH", *row) for row in triangles)


def model(name, asset="", inside=""):
    return (
        f'<mujoco model="{name}"><compiler meshdir="assets"/><asset><mesh name="m" file="{name}.stl"/>{asset}</asset>'
        f'<worldbody><body name="b"><joint/><geom type="mesh" mesh="m"/>{inside}</body></worldbody></mujoco>'
    )


attach = '<frame><attach model="hand" body="b" prefix="h_"/></frame>'
for name, text in (
    ("arm", model("arm", '<model name="hand" file="../hand/hand.xml"/>', attach)),
    ("hand", model("hand")),
):
    Path(name, "assets").mkdir(parents=True)
    Path(name, "assets", f"{name}.stl").write_bytes(stl)
    Path(name, f"{name}.xml").write_text(text)

spec = mujoco.MjSpec.from_file("arm/arm.xml")
print("mujoco", mujoco.__version__, "meshes compiled:", spec.compile().nmesh)
Path("arm/flat.xml").write_text(spec.to_xml())
print([line.strip() for line in Path("arm/flat.xml").read_text().splitlines() if "stl" in line or "meshdir" in line])
try:
    mujoco.MjModel.from_xml_path("arm/flat.xml")
except ValueError as error:
    print("seen:", " ".join(str(error).split()))
else:
    raise SystemExit("the written model compiles now")
PYTHON
