#!/bin/sh
# Pinocchio leaves an MJCF body without attributes out, with its joint and its mass, and says nothing.
#
# Guess: a <body> needs no name in MJCF, so a reader of MJCF has all bodies, or refuses the file.
# Seen: of an arm of two links whose first <body> has no attribute at all, the model has one joint and half of the mass; the
# second link hangs on the world. A name, or pos="0 0 0", brings the first one back.
# Matters: mass, reach and dynamics of the robot are others, while every number is finite and nothing is logged.
# Versions: pin 4.1.0, mujoco 3.17.0 for comparison, Python 3.11.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet pin==4.1.0 mujoco==3.17.0
cd "$work"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import mujoco
import pinocchio

ARM = """<mujoco><worldbody><body{}><joint name="shoulder" axis="0 1 0"/><geom size="0.1" mass="1"/>
  <body name="lower" pos="0 0 1"><joint name="elbow" axis="0 1 0"/><geom size="0.1" mass="1"/></body></body></worldbody></mujoco>"""
print("pinocchio", pinocchio.__version__, "mujoco", mujoco.__version__)
found = {}
for attributes in ("", ' name="upper"', ' pos="0 0 0"'):
    Path("arm.xml").write_text(ARM.format(attributes))
    peer = mujoco.MjModel.from_xml_path("arm.xml")
    model = pinocchio.buildModelFromMJCF("arm.xml")
    mass = sum(inertia.mass for inertia in model.inertias)
    print(f"<body{attributes}>: MuJoCo {peer.nv} joints, {peer.body_mass.sum()} kg; Pinocchio {model.nv}, {mass} kg")
    found[attributes] = (model.nv, mass)
if found != {"": (1, 1.0), ' name="upper"': (2, 2.0), ' pos="0 0 0"': (2, 2.0)}:
    raise SystemExit("Pinocchio reads this file otherwise now")
PYTHON
