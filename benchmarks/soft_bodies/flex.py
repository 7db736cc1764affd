"""The soft bodies that ship as flexes of MuJoCo, whole and reduced, beside their emulators: time and error."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

import neuroanimator as na
from benchmarks.soft_bodies.equal_error import ASSETS, SHOWN, STEPS, TEST_SEED, TIMINGS
from benchmarks.soft_bodies.families import FAMILIES, Family, Shape
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.learn.evaluation.speed import interleaved
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.physics.soft.soft_body import GRAVITY
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.terminal import progress_bar
from tools.soft_meshes import msh_text, obj_text

SMALL_STEPS = (1, 2, 4, 8, 16)
"""Numbers of MuJoCo's steps in a super step that are tried."""

TRUTH_STEPS = 64
"""The same of the whole flex that the others are compared with: steps of 0.5 ms."""

FULL = "full"
EQUALITIES = "full, edges as equalities"
"""A cloth as MuJoCo's documentation has it; an equality is no spring, so its motion is another, and is not compared."""

REDUCED = {"trilinear": 2, "quadratic": 3}
"""MuJoCo's reduced bodies: numbers of nodes along each side of the box around a body, by which all others follow."""

HELD_SIDE = {"cape": (2, -1), "flag": (0, 0), "jelly": (2, 0)}
"""The side of the box around a body that is held: its axis, and which end."""

POISSON = {2: 0.3, 3: 0.45}
"""Poisson's ratio, by dimension: nearer to a half MuJoCo's solver does not converge in large steps."""

LARGEST = 10.0
"""Distance over the size of a body at which its motion has diverged."""

QUICK = (0.3, 8)
"""Share of the nodes along each side, and number of super steps, of a quick trial."""

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="{integrator}" solver="CG" tolerance="1e-6"><flag autoreset="disable"/></option>
  <size memory="2G"/>
  <worldbody>
    <flexcomp name="body" type="{kind}" file="{file}" dim="{dim}" dof="{dof}" radius="0.001" mass="{mass}">
      {material}
      <contact selfcollide="none"/>
      <pin id="{pins}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class Flex:
    """One body as flexes of MuJoCo, and how what holds it moves.

    MuJoCo cannot pin nodes to a mocap body. So the body is seen from what holds it: nodes are pinned to the world, and
    gravity is less by the acceleration of the holder.
    """

    family: Family
    shape: Shape
    """Nodes along each side."""
    definition: SoftDefinition
    mass: float
    """[kg]"""
    size: float
    """[m]"""
    dt: float
    """Super step [s]."""
    accelerations: Float[np.ndarray, "T 3"]
    """Of the holder, in each super step [m/s²]."""

    @property
    def is_solid(self) -> bool:
        """Whether it is made of tetrahedra."""
        return len(self.shape) == 3

    def compiled(self, what: str, steps: int) -> mujoco.MjModel:
        """Return the model of this kind, in so many steps a super step."""
        mesh = self.family.mesh(self.shape)
        kind, dim, ending, text = "mesh", 2, "obj", obj_text
        if self.is_solid:
            kind, dim, ending, text = "gmsh", 3, "msh", msh_text
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"body.{ending}"
            file.write_text(text(mesh.positions, mesh.elements))
            written = MODEL.format(
                step=self.dt / steps,
                integrator="Euler" if what == EQUALITIES else "discrete",
                kind=kind,
                file=file,
                dim=dim,
                dof=what if what in REDUCED else "full",
                mass=self.mass,
                material=self._material(what),
                pins=" ".join(map(str, self._pins(what))),
            )
            return mujoco.MjModel.from_xml_string(written)

    def _material(self, what: str) -> str:
        """Return the elements that say what the body is made of: what its definition says, as far as MuJoCo can."""
        if what == EQUALITIES:
            return '<edge equality="true" damping="0.01"/>'
        if self.is_solid:
            solid = self.definition.solid
            values = f'young="{solid.stretch}" poisson="{POISSON[3]}" damping="{solid.damping}"'
        else:
            cloth = self.definition.cloth
            young = cloth.stretch / cloth.thickness
            values = f'young="{young}" poisson="{POISSON[2]}" damping="{cloth.damping}" '
            values += f'thickness="{cloth.thickness}" elastic2d="both"'
        return f"<elasticity {values}/>"

    def _pins(self, what: str) -> list[int]:
        """Return the nodes that are held; of a reduced body those of a side of its box."""
        if what not in REDUCED:
            return self.family.pins(self.shape).tolist()
        count = REDUCED[what]
        axis, end = HELD_SIDE[self.definition.name]
        numbers = np.arange(count**3).reshape(count, count, count)
        return numbers.take(end, axis=axis).ravel().tolist()

    def play(
        self, model: mujoco.MjModel, data: mujoco.MjData, steps: int, count: int
    ) -> Float[np.ndarray, "T N 3"] | None:
        """Return the nodes after each of `count` super steps [m]; None if the motion diverges."""
        found = []
        for acceleration in self.accelerations[:count]:
            model.opt.gravity = GRAVITY - acceleration
            try:
                mujoco.mj_step(model, data, steps)
            except mujoco.FatalError:
                return None
            mujoco.mj_fwdPosition(model, data)
            nodes = np.array(data.flexvert_xpos)
            if not np.abs(nodes).max() < LARGEST * self.size:
                return None
            found.append(nodes)
        return np.stack(found)


def flex_of(name: str, *, is_quick: bool) -> tuple[Flex, Callable[[], Any]]:
    """Return a body that ships as flexes, and what rolls its emulator out for `STEPS` super steps."""
    system = na.load_system(name)
    assert isinstance(system, SoftSystem)
    emulator = na.load_emulator(name)
    family = FAMILIES[name]
    rng = np.random.default_rng(TEST_SEED)
    controls = system.sample_paths(rng, 1, STEPS + 1, emulator.dt)[0]
    velocities = controls[:, :3]
    flex = Flex(
        family,
        family.shape_at(QUICK[0]) if is_quick else family.shape,
        check_table(read_toml(ASSETS / f"{name}.toml"), name, SoftDefinition),
        float(system.scene.masses.sum()),
        system.scene.size,
        emulator.dt,
        np.diff(velocities, axis=0) / emulator.dt,
    )
    start = system.rest.astype(np.float32)
    return flex, partial(emulator.rollout, start, controls[:STEPS].astype(np.float32))


def flex_rows(names: list[str], *, is_quick: bool) -> list[dict[str, Any]]:
    """Return, for each body, a row for its emulator and one for each flex and step, all timed in turn."""
    rows = []
    for name in names:
        rows += rows_of(name, is_quick=is_quick)
    return rows


def rows_of(name: str, *, is_quick: bool) -> list[dict[str, Any]]:
    """Return the rows of one body."""
    flex, roll_out = flex_of(name, is_quick=is_quick)
    super_steps = QUICK[1] if is_quick else STEPS
    kinds = [FULL, *REDUCED] if flex.is_solid else [EQUALITIES, FULL, *REDUCED]
    rows: list[dict[str, Any]] = [{"body": name, "what": "emulator", "times_emulator": 1.0}]
    players: dict[str, Callable[[], Any]] = {"0": roll_out}
    with warnings_counted, progress_bar(name, 1 + len(kinds) * len(SMALL_STEPS)) as bar:
        model = flex.compiled(FULL, TRUTH_STEPS)
        truth = flex.play(model, mujoco.MjData(model), TRUTH_STEPS, super_steps)
        bar.advance_to(1)
        for number, what in enumerate(kinds):
            for place, steps in enumerate(SMALL_STEPS):
                model = flex.compiled(what, steps)
                data = mujoco.MjData(model)
                nodes = flex.play(model, data, steps, super_steps)
                bar.advance_to(2 + number * len(SMALL_STEPS) + place)
                row: dict[str, Any] = {"body": name, "what": what, "degrees": model.nv}
                row |= {"nodes": model.nflexvert, "steps": steps, "step_ms": flex.dt / steps * 1e3}
                if nodes is None:
                    row["what"] = f"{what}: diverges"
                    rows.append(row)
                    continue
                if what != EQUALITIES:
                    row |= errors_of(flex, nodes, truth)
                players[str(len(rows))] = partial(mujoco.mj_step, model, data, steps)
                rows.append(row)
        add_times(rows, players)
    columns = ["body", "what", "nodes", "degrees", "steps", "step_ms", "us_a_step"]
    columns += ["us_a_super_step", "times_emulator", *(f"error_{step}_percent" for step in SHOWN)]
    return [{column: line.get(column, "") for column in columns} for line in rows]


def errors_of(
    flex: Flex, nodes: Float[np.ndarray, "T N 3"], truth: Float[np.ndarray, "T N 3"] | None
) -> dict[str, float]:
    """Return how far nodes are from the whole flex in the smallest steps [% of the size, root mean square]."""
    assert truth is not None, "the whole flex diverges in its smallest steps"
    squares = ((nodes - truth) ** 2).sum(axis=-1).mean(axis=-1)
    share = 100 * np.sqrt(squares) / flex.size
    return {f"error_{step}_percent": float(share[step - 1]) for step in SHOWN if step <= len(share)}


def add_times(rows: list[dict[str, Any]], players: dict[str, Callable[[], Any]]) -> None:
    """Add to rows what a step and a super step take [µs], and how many times the emulator's that is.

    `players` are by the number of their row; that of the emulator rolls out for `STEPS` super steps.
    """
    seconds = interleaved(players, TIMINGS)
    emulator = seconds.pop("0") / STEPS * 1e6
    rows[0]["us_a_super_step"] = emulator
    for number, spent in seconds.items():
        row = rows[int(number)]
        row["us_a_super_step"] = spent * 1e6
        row["times_emulator"] = spent * 1e6 / emulator
        row["us_a_step"] = spent / row["steps"] * 1e6
