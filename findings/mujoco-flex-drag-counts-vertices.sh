#!/usr/bin/env bash
# Guess: a cloth made by flexcomp falls through MuJoCo's air (option density) as a plate does: slowly flat, fast on its edge, and
# as fast with a finer mesh.
#
# Seen instead: air pushes every vertex by the inertia box of its point mass, and knows nothing of faces. A square of 1 m and
# 0.2 kg falls as fast flat as on its edge, to all digits but the last ones, and the faster the coarser its mesh is: after 2 s at
# 17.9, 15.1 and 10.1 m/s with 5, 9 and 17 vertices a side. A rigid plate of that size and mass falls at 1.8 and 14.4 m/s.
#
# Why it matters: flags, capes and parachutes by flexcomp neither fill nor flap in wind, and their drag is set by the mesh. A
# policy or a model learnt with one mesh meets other air with the next. Drag of faces has to be added from outside.
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

CLOTH = """<flexcomp name="cloth" type="grid" dim="2" count="{n} {n} 1" spacing="{gap} {gap} 1" mass="0.2" radius="0.005">
<edge equality="true"/><contact selfcollide="none" contype="0" conaffinity="0"/></flexcomp>"""
PLATE = '<freejoint/><geom type="box" size="0.5 0.5 0.005" mass="0.2"/>'
WORLD = """<mujoco><option timestep="0.001" density="1.2" viscosity="1.8e-5" integrator="implicitfast"/>
<worldbody><body name="holder" pos="0 0 100" euler="0 {angle} 0">{body}</body></worldbody></mujoco>"""


def fall(body, angle):
    model = mujoco.MjModel.from_xml_string(WORLD.format(angle=angle, body=body))
    data = mujoco.MjData(model)
    heights = []
    for _ in range(2001):
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        heights.append(data.flexvert_xpos[:, 2].mean() if model.nflex else data.qpos[2])
    return (heights[-2] - heights[-1]) / model.opt.timestep


print("mujoco", mujoco.__version__)
seen = {}
for n in (5, 9, 17):
    seen[n] = [fall(CLOTH.format(n=n, gap=1 / (n - 1)), angle) for angle in (0, 90)]
    print(f"cloth of {n} x {n} vertices: flat {seen[n][0]:.2f} m/s, on its edge {seen[n][1]:.2f} m/s")
plate = [fall(PLATE, angle) for angle in (0, 90)]
print(f"rigid plate: flat {plate[0]:.2f} m/s, on its edge {plate[1]:.2f} m/s")
assert plate[1] > 5 * plate[0]
for flat, edge in seen.values():
    assert abs(flat - edge) < 1e-3 * flat, "the orientation of a cloth matters now"
assert seen[5][0] > 1.1 * seen[9][0] > 1.1 * 1.1 * seen[17][0], "the mesh does not matter any more"
PYTHON
