"""A family of pendulums shared by tests: one link whose mass, damping and motor differ from body to body."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from neuroanimator.scaffold.write_toml import write_definition

ARM = """<mujoco><option timestep="0.005" integrator="RK4"/>
  <worldbody><body name="upper" pos="0 0 2"><joint name="shoulder" axis="0 1 0" damping="{damping}"/>
    <geom name="link" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04" mass="{mass}" contype="0" conaffinity="0"/>
    <body name="lower" pos="0 0 {pos}"><joint name="elbow" axis="0 1 0" damping="0.1" range="-150 150" limited="true"/>
      <geom name="tip" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.5" contype="0" conaffinity="0"/>
    </body></body></worldbody>
  <actuator><motor name="shoulder" joint="shoulder" ctrlrange="-4 4" gear="{gear}"/>
    <motor name="elbow" joint="elbow" ctrlrange="-2 2"/></actuator></mujoco>"""
"""A double pendulum whose shoulder's damping and gear, mass and length are left open."""

NOMINAL = {"damping": 0.2, "mass": 1.0, "pos": -0.4, "gear": 1.0}

TARGETS = {
    "damping": "joint/shoulder/damping",
    "mass": "body/upper/mass",
    "pos": "body/lower/pos[2]",
    "gear": "actuator/shoulder/gear",
}
"""What a parameter of each name sets."""

RANGES = {"damping": (0.1, 0.4), "mass": (0.7, 1.4), "pos": (-0.5, -0.3), "gear": (0.6, 1.5)}


def parameter_lines(names: tuple[str, ...] = tuple(TARGETS)) -> str:
    """Return the table of the parameters called `names`."""
    lines = ["", "[parameters]"]
    for name in names:
        low, high = RANGES[name]
        lines.append(f'{name} = {{ sets = "{TARGETS[name]}", range = [{low}, {high}] }}')
    return "\n".join(lines) + "\n"


def write_arm(folder: Path, values: Mapping[str, float], extra: str = "") -> Path:
    """Write the arm with `values` in place of nominal ones, and its TOML file with `extra` lines; return that one's path."""
    model = ARM.format(**(NOMINAL | dict(values)))
    (folder / "arm.xml").write_text(model)
    path = folder / "arm.toml"
    path.write_text(proposed(model) + extra)
    return path


@cache
def proposed(model: str) -> str:
    """Return the TOML file that `new` writes for an arm; that takes a second of simulation, so each is made once."""
    with TemporaryDirectory() as folder:
        source = Path(folder) / "arm.xml"
        source.write_text(model)
        path, _ = write_definition(str(source))
        return path.read_text().replace("reset_share = 0.2", "reset_share = 0.1")
