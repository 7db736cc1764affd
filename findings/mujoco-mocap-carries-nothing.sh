#!/usr/bin/env bash
# Guess: a box on a plate that a mocap body moves sideways, slowly, with friction 1, goes along with the plate.
#
# Seen instead: to MuJoCo a mocap body stands still at every step, wherever it was put. Its contacts push, but drag nothing: the
# plate passes 1 m under the box, which stays where it was to the last digit. On a slide joint driven at the same speed the
# same plate takes the box along.
#
# Why it matters: mocap bodies are the usual way to let a recorded hand, a human's bones or a conveyor act on a scene. What
# they hold by friction slips, cloth does not follow the shoulder it lies on, and data of it teach that. Drive such bodies by
# joints, or weld a dynamic body to the mocap one.
#
# Versions: mujoco 3.17.0.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet mujoco==3.17.0
cd "$work"
venv/bin/python - <<'PYTHON'
import mujoco

SPEED, SECONDS = 0.5, 2.0
SCENE = """<mujoco><option timestep="0.002"/><worldbody>
<body name="plate" {mocap}>{joint}<geom type="box" size="2 1 0.05" friction="1" mass="1000"/></body>
<body pos="0 0 0.15"><freejoint name="box"/><geom type="box" size="0.1 0.1 0.1" friction="1"/></body>
</worldbody></mujoco>"""


def carried(is_mocap):
    joint = "" if is_mocap else '<joint name="slide" type="slide" axis="1 0 0"/>'
    model = mujoco.MjModel.from_xml_string(SCENE.format(mocap='mocap="true"' if is_mocap else 'gravcomp="1"', joint=joint))
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    box = data.joint("box")
    start = box.qpos[0]
    for _ in range(round(SECONDS / model.opt.timestep)):
        if is_mocap:
            data.mocap_pos[0, 0] += SPEED * model.opt.timestep
        else:
            data.joint("slide").qvel[0] = SPEED
        mujoco.mj_step(model, data)
    return box.qpos[0] - start


print("mujoco", mujoco.__version__)
by_mocap, by_joint = carried(True), carried(False)
print(f"the plate moves {SPEED * SECONDS:g} m; the box moves {by_mocap:.3f} m on a mocap body, {by_joint:.3f} m on a joint")
assert by_joint > 0.9 * SPEED * SECONDS
assert abs(by_mocap) < 1e-6, "a mocap body carries what lies on it now"
PYTHON
