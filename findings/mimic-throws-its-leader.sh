#!/usr/bin/env bash
# Guess: MuJoCo, which reads <mimic> of a URDF since 3.17, starts such a robot as the URDF says, follower = offset + multiplier
# times leader, and the leader moves as if nothing followed it; a leader that does not exist is an error.
#
# Seen instead: the reference pose has both joints at 0, whatever the offset says. The mimic is a soft equality that pulls at
# both: in a robot without gravity, motors or friction the leader is thrown at some rad/s and ends half the offset away. A
# leader that is misspelt leaves the joint free, with a warning about the type of its joint.
#
# Why it matters: grippers and arms with mimics jump at the first steps of every episode; random starts drawn joint by joint
# do so all the time, and data of them teach the jump. Put the follower where its leader says, and leave the leader alone,
# before the first step; look whether model.neq counts every mimic.
#
# Versions: mujoco 3.17.0.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mujoco==3.17.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco

LINK = (
    '<link name="{}"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="continuous"><parent link="base"/><child link="{}"/><axis xyz="0 0 1"/>{}</joint>'
)
MIMIC = '<mimic joint="{}" multiplier="1" offset="0.5"/>'


def robot(leader):
    links = "".join(LINK.format(name) for name in ("base", "a", "b"))
    joints = JOINT.format("leader", "a", "") + JOINT.format("follower", "b", MIMIC.format(leader))
    return mujoco.MjModel.from_xml_string(f'<robot name="r">{links}{joints}</robot>')


print("mujoco", mujoco.__version__)
model = robot("leader")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
gap = abs(float(data.efc_pos[0]))
print(f"equalities {model.neq}; at the reference pose the follower is {gap:.2f} rad off its leader")
fastest = 0.0
for _ in range(500):
    mujoco.mj_step(model, data)
    fastest = max(fastest, abs(float(data.qvel[0])))
leader, follower = (float(angle) for angle in data.qpos)
print(f"the leader, which nothing drives, reached {fastest:.2f} rad/s and ends at {leader:.2f} rad, its follower at {follower:.2f}")
misspelt = robot("laeder").neq
print(f"equalities with a misspelt leader: {misspelt}, and no error")
is_as_seen = gap == 0.5 and fastest > 1 and abs(leader + 0.25) < 0.01 and misspelt == 0
raise SystemExit(0 if is_as_seen else "This has changed: look at what MuJoCo does now.")
PYTHON
