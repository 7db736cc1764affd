"""Parameters of a MuJoCo model: attributes of its elements, set in the compiled model.

`body/forearm/mass` is the attribute `mass` of the body `forearm`; others are `geom/foot/friction` and `body/shin/pos[2]`;
`geom/friction` is the friction of all geoms, which must be the same. Names of elements and attributes are those of MJCF,
units are MuJoCo's.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.parts import ParameterTable
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known, model_name
from neuroanimator.physics.rigid.rows import rows_at
from neuroanimator.physics.state_parts import parameter_from_table
from neuroanimator.state.parameters import (
    Parameter,
    nominal_values,
)
from neuroanimator.text import listed, quoted

OPTION = "option"
"""The only element without a name: gravity, wind, and the medium."""

COUNTS = {
    "body": "nbody",
    "joint": "njnt",
    "geom": "ngeom",
    "actuator": "nactuator",
    "tendon": "ntendon",
    "pair": "npair",
}
"""Field of a model with the number of its elements of each kind."""

PATTERN = re.compile(
    r"(?:(?P<element>\w+)/)(?:(?P<name>.+)/)?(?P<attribute>\w+)(?:\[(?P<index>\d)\])?"
)
"""Pattern of a parameter's target: element/name/attribute[index]."""

SLIDE = mujoco.mjtJoint.mjJNT_SLIDE

LEAST = 1e-9
"""Minimum mass, inertia or length of a body, in SI units."""

MAX_KEPT = 1024
"""Maximum number of bodies' models kept."""

KEPT_BYTES = 2**27
"""Maximum total size of these models [bytes]."""

MAX_CORNERS = 10
"""Maximum number of parameters of one element whose ends are tried in all combinations."""

MAX_MESSAGE = 200
"""Maximum number of characters shown of MuJoCo's message."""

TRIANGLE_TOLERANCE = 1e-6
"""Relative tolerance of the largest moment of inertia above the sum of the others, for rounding."""


class Attribute(NamedTuple):
    """An attribute of an element in a compiled model."""

    unit: str
    """Its unit; for a joint, that of a hinge."""
    least: float
    """Smallest possible value."""
    numbers: int
    """Number of its numbers."""
    default: int | None
    """Default index; None if one must be given."""
    read: Callable[[mujoco.MjModel, int, int], float]
    """Returns its value, given (model, number of the element, index)."""
    write: Callable[[mujoco.MjModel, int, int, float], None]
    """Sets its value, given (model, number of the element, index, value)."""
    sliding_unit: str = ""
    """Its unit for a slide."""


class Target(NamedTuple):
    """An attribute of one element of a model, or of all of a kind, with the same value."""

    element: str
    numbers: tuple[int, ...]
    """Numbers of the elements among those of their kind."""
    name: str
    """Name of the attribute."""
    attribute: Attribute
    place: int
    """Index into an attribute of several numbers."""

    def unit(self, model: mujoco.MjModel) -> str:
        """Return its unit."""
        slides = self.element == "joint" and model.jnt_type[self.numbers[0]] == SLIDE
        return self.attribute.sliding_unit if slides else self.attribute.unit

    def read(self, model: mujoco.MjModel) -> float:
        """Return its value in `model`."""
        return self.attribute.read(model, self.numbers[0], self.place)

    def write(self, model: mujoco.MjModel, value: float) -> None:
        """Set it in `model`."""
        for number in self.numbers:
            self.attribute.write(model, number, self.place, value)


def _field(
    field: str,
    unit: str,
    least: float = -np.inf,
    count: int = 1,
    default: int | None = 0,
    rows: Callable[[mujoco.MjModel, int], slice] = lambda _, number: slice(number, number + 1),
) -> Attribute:
    """Return the attribute that is one or more equal `rows` of `field`, an array of the model."""

    def read(model: mujoco.MjModel, number: int, index: int) -> float:
        return float(getattr(model, field)[rows(model, number)].flat[index])

    def write(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
        chosen = getattr(model, field)[rows(model, number)]
        chosen.reshape(len(chosen), -1)[:, index] = value

    return Attribute(unit, least, count, default, read, write)


def _freedoms(model: mujoco.MjModel, joint: int) -> slice:
    """Return the degrees of freedom of a joint."""
    return rows_at(model.jnt_dofadr[joint], np.count_nonzero(model.dof_jntid == joint))


def _forces(model: mujoco.MjModel, actuator: int) -> slice:
    """Return the forces of an actuator."""
    return rows_at(model.actuator_outadr[actuator], model.actuator_outnum[actuator])


def _of_option(field: str, unit: str, count: int, least: float = -np.inf) -> Attribute:
    """Return the attribute that is `field` of the model's options."""

    def read(model: mujoco.MjModel, number: int, index: int) -> float:
        return float(np.atleast_1d(getattr(model.opt, field))[index])

    def write(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
        if count == 1:
            setattr(model.opt, field, value)
        else:
            getattr(model.opt, field)[index] = value

    return Attribute(unit, least, count, 0 if count == 1 else None, read, write)


def _write_mass(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    """Set the mass of a body at the same shape: its moments of inertia scale with it."""
    model.body_inertia[number] *= value / model.body_mass[number]
    model.body_mass[number] = value


def _write_inertia_factor(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    model.body_inertia[number] *= value


def _is_pid(model: mujoco.MjModel, actuator: int) -> bool:
    return bool(model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_PID)


def _read_kp(model: mujoco.MjModel, number: int, index: int) -> float:
    if _is_pid(model, number):
        return -float(model.actuator_biasprm[number, 1])
    return float(model.actuator_gainprm[number, 0])


def _write_kp(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    """Set the gain; for a position servo that of its feedback, too, and of a PID servo that alone."""
    is_pid = _is_pid(model, number)
    if is_pid or model.actuator_biasprm[number, 1] == -model.actuator_gainprm[number, 0]:
        model.actuator_biasprm[number, 1] = -value
    if not is_pid:
        model.actuator_gainprm[number, 0] = value


def _write_kv(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    model.actuator_biasprm[number, 2] = -value


def _write_pair_friction(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    """Set a pair's sliding friction in both directions."""
    model.pair_friction[number, :2] = value


def _write_scale(model: mujoco.MjModel, number: int, index: int, value: float) -> None:
    """Scale all lengths of a body and of those below it, at constant density."""
    below = _subtree(model, number)
    deeper = [body for body in below if body != number]
    model.body_pos[deeper] *= value
    model.body_ipos[below] *= value
    model.body_mass[below] *= value**3
    model.body_inertia[below] *= value**5
    joints = np.isin(model.jnt_bodyid, below)
    model.jnt_pos[joints] *= value
    geoms = np.isin(model.geom_bodyid, below)
    for lengths in (model.geom_pos, model.geom_size, model.geom_rbound, model.geom_aabb):
        lengths[geoms] *= value
    sites = np.isin(model.site_bodyid, below)
    model.site_pos[sites] *= value
    model.site_size[sites] *= value


def _subtree(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the numbers of `body` and of all bodies below it."""
    inside = [body]
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in inside:
            inside.append(other)
    return inside


ATTRIBUTES: dict[str, dict[str, Attribute]] = {
    "body": {
        "mass": _field("body_mass", "kg", LEAST)._replace(write=_write_mass),
        "scale": Attribute("1", LEAST, 1, 0, lambda *_: 1.0, _write_scale),
        "pos": _field("body_pos", "m", count=3, default=None),
        "ipos": _field("body_ipos", "m", count=3, default=None),
        "inertia_factor": Attribute("1", LEAST, 1, 0, lambda *_: 1.0, _write_inertia_factor),
        "inertia": _field("body_inertia", "kg·m²", LEAST, count=3, default=None),
        "gravcomp": _field("body_gravcomp", "1"),
    },
    "joint": {
        "damping": _field("dof_damping", "N·m·s/rad", 0.0, rows=_freedoms)._replace(
            sliding_unit="N·s/m"
        ),
        "frictionloss": _field("dof_frictionloss", "N·m", 0.0, rows=_freedoms)._replace(
            sliding_unit="N"
        ),
        "armature": _field("dof_armature", "kg·m²", 0.0, rows=_freedoms)._replace(
            sliding_unit="kg"
        ),
        "stiffness": _field("jnt_stiffness", "N·m/rad", 0.0)._replace(sliding_unit="N/m"),
        "range": _field("jnt_range", "rad", count=2, default=None)._replace(sliding_unit="m"),
    },
    "geom": {
        "friction": _field("geom_friction", "1", 0.0, count=3),
        "size": _field("geom_size", "m", LEAST, count=3, default=None),
        "solref": _field("geom_solref", "1", count=2, default=None),
        "solimp": _field("geom_solimp", "1", count=5, default=None),
    },
    "actuator": {
        "gear": _field("actuator_gear", "1", count=6, rows=_forces),
        "gain": Attribute("1", -np.inf, 1, 0, _read_kp, _write_kp),
        "kp": Attribute("1", 0.0, 1, 0, _read_kp, _write_kp),
        "kv": Attribute(
            "1",
            0.0,
            1,
            0,
            lambda model, number, _: -float(model.actuator_biasprm[number, 2]),
            _write_kv,
        ),
    },
    "tendon": {
        "stiffness": _field("tendon_stiffness", "1", 0.0),
        "damping": _field("tendon_damping", "1", 0.0),
        "frictionloss": _field("tendon_frictionloss", "1", 0.0),
    },
    "pair": {
        "friction": _field("pair_friction", "1", 0.0)._replace(write=_write_pair_friction),
        "solref": _field("pair_solref", "1", count=2, default=None),
        "solimp": _field("pair_solimp", "1", count=5, default=None),
    },
    OPTION: {
        "gravity": _of_option("gravity", "m/s²", 3),
        "wind": _of_option("wind", "m/s", 3),
        "density": _of_option("density", "kg/m³", 1, 0.0),
        "viscosity": _of_option("viscosity", "Pa·s", 1, 0.0),
    },
}
"""Attributes that can be parameters, by element."""

ORDER = ("scale", "mass", "inertia_factor")
"""Attributes that are set before all others, as they change those, too."""


class Family:
    """A model and its parameters: it makes the model of any body of the family."""

    def __init__(self, model: mujoco.MjModel, tables: Mapping[str, ParameterTable]):
        """Raises ArgumentError for a missing element or attribute, and for ends that make an impossible body."""
        self.model = model
        self._kept: dict[tuple[bytes, float, int], mujoco.MjModel] = {}
        self._data = mujoco.MjData(model)
        self._lock = Lock()
        self.parameters: tuple[Parameter, ...] = ()
        self._targets: list[Target] = []
        for name, table in tables.items():
            target = _find_target(model, name, table)
            unit = target.unit(model)
            own = target.read(model)
            self._targets.append(target)
            self.parameters += (parameter_from_table(name, table, unit, own),)
        self._order = sorted(range(len(self._targets)), key=self._rank)
        self._refuse_impossible()

    def model_at(
        self, values: Float[np.ndarray, " P"], like: mujoco.MjModel | None = None
    ) -> mujoco.MjModel:
        """Return a copy of the model, or of one `like` it except for its step, with these parameters.

        It must not be changed: it is kept for reuse, as bodies of an episode are needed at every step.
        """
        model = like or self.model
        key = (values.tobytes(), model.opt.timestep, model.opt.integrator)
        with self._lock:
            kept = self._kept.get(key)
            if kept is None:
                kept = model.__copy__()
                self._write(kept, values)
                mujoco.mj_setConst(kept, self._data)
                if len(self._kept) >= min(MAX_KEPT, KEPT_BYTES // model.nbuffer):
                    self._kept.clear()
                self._kept[key] = kept
            return kept

    def _write(self, model: mujoco.MjModel, values: Sequence[float] | np.ndarray) -> None:
        for place in self._order:
            self._targets[place].write(model, float(values[place]))

    def _rank(self, place: int) -> int:
        name = self._targets[place].name
        return ORDER.index(name) if name in ORDER else len(ORDER)

    def _refuse_impossible(self) -> None:
        """Raise ArgumentError if some combination of the ends of ranges makes an impossible body.

        Only parameters of the same element are combined, such as mass and moments of inertia, or both ends of a range.
        """
        nominal = nominal_values(self.parameters)
        elements = {
            (target.element, number) for target in self._targets for number in target.numbers
        }
        for element, number in sorted(elements):
            places = [
                place
                for place, target in enumerate(self._targets)
                if target.element == element and number in target.numbers
            ][:MAX_CORNERS]
            ends = [(self.parameters[p].low, self.parameters[p].high) for p in places]
            for corner in itertools.product(*ends):
                values = nominal.copy()
                values[places] = corner
                fault = self._fault(values, element, number)
                if fault:
                    names = ", ".join(
                        f"{self.parameters[place].name} = {value:g}"
                        for place, value in zip(places, corner, strict=True)
                    )
                    raise ArgumentError(f"parameters: with {names} {fault}. Narrow the range.")

    def _fault(self, values: Float[np.ndarray, " P"], element: str, number: int) -> str:
        """Return why a body with these values is impossible; empty if it is possible."""
        try:
            model = self.model_at(values)
        except mujoco.FatalError as error:
            message = " ".join(str(error).split())[:MAX_MESSAGE]
            return f'MuJoCo refuses it: {message}; if it is a body compiled as simple, say simple="false" in its <body>'
        return _impossible(model, element, number)


def _find_target(model: mujoco.MjModel, name: str, table: ParameterTable) -> Target:
    """Return the target of the parameter called `name`; ArgumentError says what is missing, and lists what exists."""
    where = f"parameters.{name}.sets"
    match = PATTERN.fullmatch(table.sets)
    if match is None or match["element"] not in ATTRIBUTES:
        raise ArgumentError(
            f"{where}: wanted element/name/attribute such as body/forearm/mass, got {quoted(table.sets)}. "
            f"Elements: {listed(ATTRIBUTES)}."
        )
    element = match["element"]
    check_known([match["attribute"]], ATTRIBUTES[element], "attribute", f"{where}: {element}")
    attribute = ATTRIBUTES[element][match["attribute"]]
    numbers = _find_elements(model, where, element, match["name"])
    index = attribute.default
    if match["index"] is not None:
        index = int(match["index"])
    if index is None or index >= attribute.numbers:
        raise ArgumentError(
            f"{where}: wanted one of its {attribute.numbers} numbers, {match['attribute']}[0] to "
            f"[{attribute.numbers - 1}], got {quoted(table.sets)}."
        )
    target = Target(element, numbers, match["attribute"], attribute, index)
    _refuse_unfit(model, where, target, table)
    return target


def _find_elements(
    model: mujoco.MjModel, where: str, element: str, name: str | None
) -> tuple[int, ...]:
    """Return the number of the element called `name`; without a name, those of all of its kind, except bodies."""
    if element == OPTION:
        return (0,)
    names = [
        model_name(getattr(model, element)(i).name, f"{element}_{i}")
        for i in range(getattr(model, COUNTS[element]))
    ]
    if name is None and names and element != "body":  # the world is a body, too
        return tuple(range(len(names)))
    wanted = name or ""
    check_known([wanted], names, element, where)
    return (names.index(wanted),)


def _refuse_unfit(model: mujoco.MjModel, where: str, target: Target, table: ParameterTable) -> None:
    """Raise ArgumentError for values that are too small, for elements that differ, for a body without mass, and for a body
    that cannot be scaled."""
    low = table.range[0]
    least = target.attribute.least
    if low < least:
        wanted = "above 0" if least == LEAST else f"at least {least:g}"
        raise ArgumentError(
            f"{where}: with a {target.name} of {low:g} there is no such {target.element}; wanted {wanted}."
        )
    own = {target.attribute.read(model, number, target.place) for number in target.numbers}
    if len(own) > 1:
        raise ArgumentError(
            f"{where}: the values to be set together differ, from {min(own):g} to {max(own):g}. Name one: "
            f"{target.element}/NAME/{target.name}."
        )
    first = target.numbers[0]
    if target.name == "mass" and model.body_mass[first] < LEAST:
        raise ArgumentError(
            f"{where}: this body has no mass of its own. Name the one that carries it."
        )
    if target.name == "scale":
        inside = np.isin(model.geom_bodyid, _subtree(model, first))
        meshes = model.geom_dataid[inside] >= 0
        if meshes.any() or model.neq or model.ntendon:
            raise ArgumentError(
                f"{where}: a part with meshes, tendons or equality constraints cannot be scaled. Use primitive shapes, or "
                "set masses and positions one by one."
            )


def _impossible(model: mujoco.MjModel, element: str, number: int) -> str:
    """Return why such a body or joint is impossible; empty if it is possible."""
    if element == "body":
        moments = np.sort(model.body_inertia[number])
        if moments[2] > (moments[0] + moments[1]) * (1 + TRIANGLE_TOLERANCE):
            shown = ", ".join(f"{moment:.3g}" for moment in model.body_inertia[number])
            return (
                f"a body has moments of inertia of {shown} kg·m², of which one exceeds the sum of the others, "
                "as in no real body"
            )
    if element == "joint" and model.jnt_limited[number]:
        low, high = model.jnt_range[number]
        if not low < high:
            return f"the range of a joint is inverted, {low:g} to {high:g}"
    return ""
