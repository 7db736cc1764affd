#!/usr/bin/env bash
# Guess: mj_getState with mjSTATE_FULLPHYSICS keeps all that decides how a motion goes on, so that mj_setState, or
# mujoco.rollout from such a state, continues it.
#
# Seen instead: it leaves out which equality constraints are active. A ball released from a mocap hand
# (data.eq_active[0] = 0) falls; the same full physics state in another MjData, or in mujoco.rollout, hangs at the hand
# again, since eq_active is counted among the inputs (mjSTATE_USER), not the physics. mjSTATE_INTEGRATION continues it.
#
# Why it matters: grasps and releases are often written as welds that are switched at run time. Replays, planning and data
# from saved full physics states then simulate another grasp than the one that was saved, without an error.
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
import numpy as np
from mujoco import rollout

MODEL = """<mujoco><worldbody>
  <body name="hand" mocap="true" pos="0 0 1"/>
  <body name="ball" pos="0 0 1"><freejoint/><geom size="0.05"/></body>
</worldbody><equality><weld name="grip" body1="hand" body2="ball"/></equality></mujoco>"""
STEPS = 250


def restored(spec):
    """Return a copy of the released ball's data by a state of `spec`."""
    state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, released, state, spec)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, spec)
    return data, state


print("mujoco", mujoco.__version__)
model = mujoco.MjModel.from_xml_string(MODEL)
released = mujoco.MjData(model)
released.eq_active[0] = 0
full, state = restored(mujoco.mjtState.mjSTATE_FULLPHYSICS)
whole, _ = restored(mujoco.mjtState.mjSTATE_INTEGRATION)
rolled, _ = rollout.rollout(model, mujoco.MjData(model), state[None], nstep=STEPS)
for data in (released, full, whole):
    mujoco.mj_step(model, data, STEPS)
heights = {
    "released": float(released.qpos[2]),
    "restored by mjSTATE_FULLPHYSICS": float(full.qpos[2]),
    "mujoco.rollout": float(np.asarray(rolled)[0, -1, 3]),
    "restored by mjSTATE_INTEGRATION": float(whole.qpos[2]),
}
for name, height in heights.items():
    print(f"height of the ball after 0.5 s, {name}: {height:.2f} m")
falls, *hanging, also_falls = heights.values()
is_as_seen = falls < 0 and abs(also_falls - falls) < 1e-9 and all(height > 0.99 for height in hanging)
raise SystemExit(0 if is_as_seen else "This has changed: look at what MuJoCo does now.")
PYTHON
