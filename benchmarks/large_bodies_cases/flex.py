"""The meshes of the soft bodies that ship as flexes of MuJoCo: the time of a step."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from soft_meshes import msh_text, obj_text

from large_bodies_cases.families import FAMILIES, Family

SUPER_STEP = 1 / 30
"""[s]"""

STEPS = {"cape": (4e-3, 2e-3, 1e-3), "flag": (4e-3, 2e-3, 1e-3), "jelly": (1e-3, 5e-4, 2e-4, 1e-4)}
"""Steps tried, the largest first [s]."""

DURATION = 0.1
"""Time for which numbers must stay finite [s]."""

TIMED = 20
"""Number of steps timed; the median counts."""

LARGEST = 100.0
"""Position at which a motion has diverged [m]."""

MODEL = """
<mujoco>
  <option timestep="{step}" solver="CG" tolerance="1e-6"/>
  <size memory="2G"/>
  <worldbody>
    <geom type="plane" size="5 5 .1" pos="0 0 -1"/>
    <body mocap="true" pos="0 0 0.6"><geom type="capsule" size="0.05" fromto="0 -.2 0 0 .2 0"/></body>
    <flexcomp name="body" type="{kind}" file="{file}" dim="{dim}" radius="0.005" mass="{mass}">
      {stiffness}
      <contact selfcollide="none"/>
      {pins}
    </flexcomp>
  </worldbody>
</mujoco>
"""


def flex_rows() -> list[dict[str, Any]]:
    """Return a row per body: the largest step that stays finite, its time and that of a super step."""
    rows = []
    for name, family in FAMILIES.items():
        for step in STEPS[name]:
            model = compiled(name, family, step)
            seconds = time_of_step(model)
            if seconds is not None:
                rows.append(
                    {
                        "body": name,
                        "nodes": model.nflexvert,
                        "step_ms": step * 1e3,
                        "us_a_step": seconds * 1e6,
                        "us_a_super_step": seconds * SUPER_STEP / step * 1e6,
                    }
                )
                break
    return rows


def compiled(name: str, family: Family, step: float) -> mujoco.MjModel:
    """Return the model: a cloth's edges are equalities, a solid is elastic."""
    mesh = family.mesh(family.shape)
    is_solid = len(family.shape) == 3
    kind, dim, ending, mass = ("gmsh", 3, "msh", 4) if is_solid else ("mesh", 2, "obj", 0.3)
    text = msh_text if is_solid else obj_text
    stiffness = '<edge equality="true" damping="0.01"/>'
    if is_solid:
        stiffness = '<elasticity young="3e4" poisson="0.4" damping="0.01"/>'
    ids = " ".join(str(pin) for pin in family.pins(family.shape))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.{ending}"
        file.write_text(text(mesh.positions, mesh.elements))
        written = MODEL.format(
            step=step,
            kind=kind,
            file=file,
            dim=dim,
            mass=mass,
            stiffness=stiffness,
            pins=f'<pin id="{ids}"/>' if ids else "",
        )
        return mujoco.MjModel.from_xml_string(written)


def time_of_step(model: mujoco.MjModel) -> float | None:
    """Return the median time of a step [s]; None if the motion diverges."""
    data = mujoco.MjData(model)
    times = []
    steps = max(TIMED, round(DURATION / model.opt.timestep))
    for _ in range(steps):
        began = time.perf_counter()
        mujoco.mj_step(model, data)
        times.append(time.perf_counter() - began)
        if not np.abs(data.qpos).max() < LARGEST:
            return None
    return float(np.median(times[-TIMED:]))
