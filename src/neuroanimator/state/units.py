"""The units of states and controls: SI and radians, so that nothing needs converting inside."""

from __future__ import annotations

import math

from neuroanimator.errors import BadFileError

DEGREE = math.pi / 180
"""A degree [rad]."""

KNOWN_UNITS = (
    "1", "m", "m/s", "m/s²", "rad", "rad/s", "rad/s²", "N", "N·m", "kg", "s", "Hz", "Pa", "K", "J", "W", "V", "A",
    "m²", "m³", "m³/s", "kg/s", "K/s", "Pa/s", "1/s", "V/s", "A/s", "N/s",
    "kg·m²", "kg/m³", "Pa·s", "N/m", "N·s/m", "N·m/rad", "N·m·s/rad", "kg/(m²·s)",
)  # fmt: skip

SPELLINGS = {
    "m/s2": "m/s²", "m/s^2": "m/s²", "rad/s2": "rad/s²", "rad/s^2": "rad/s²", "Nm": "N·m", "N*m": "N·m", "N.m": "N·m",
    "m2": "m²", "m^2": "m²", "m3": "m³", "m^3": "m³", "m3/s": "m³/s", "m^3/s": "m³/s", "s^-1": "1/s",
    "kg*m^2": "kg·m²", "kg*m2": "kg·m²", "kg/m^3": "kg/m³", "kg/m3": "kg/m³", "Pa*s": "Pa·s", "N*s/m": "N·s/m",
    "N*m/rad": "N·m/rad", "Nm/rad": "N·m/rad", "N*m*s/rad": "N·m·s/rad", "Nms/rad": "N·m·s/rad",
}  # fmt: skip
"""Other spellings of some of them, for keyboards without ² and ·."""


STATE_UNITS = frozenset((*KNOWN_UNITS, "quaternion"))
"""Units of the parts of a state or control in systems and emulators: orientations have a unit of their own."""


def known_unit(unit: str, where: str) -> str:
    """Return the unit's canonical spelling; BadFileError names `where` it was and lists the known ones."""
    unit = SPELLINGS.get(unit, unit)
    if unit not in KNOWN_UNITS:
        raise BadFileError(
            f"{where}: unknown unit {unit[:20]!r}. Convert to one of: {', '.join(KNOWN_UNITS)} (1 for a plain number)."
        )
    return unit


PREFIXES = {"k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
"""Factors of the prefixes of units."""

CONVERTED = {
    "rpm": ("rad/s", 6 * DEGREE), "km/h": ("m/s", 1 / 3.6), "min": ("s", 60.0), "%": ("1", 1e-2), "-": ("1", 1.0),
}  # fmt: skip
"""Further units that numbers of a recording may have: the one they are converted to, and the factor."""


def converted_unit(unit: str, where: str) -> tuple[str, float]:
    """Return the unit inside, and the factor by which numbers in `unit` are multiplied: of degrees, millimetres and others.

    BadFileError names `where` it was if it is unknown.
    """
    if unit in CONVERTED:
        return CONVERTED[unit]
    radians = unit.replace("deg", "rad").replace("°", "rad")
    if radians != unit:
        return known_unit(radians, where), DEGREE
    whole = SPELLINGS.get(unit[1:], unit[1:])
    is_power = whole[1:2] in ("²", "³")
    if (
        SPELLINGS.get(unit, unit) not in KNOWN_UNITS
        and unit[:1] in PREFIXES
        and not is_power
        and whole in KNOWN_UNITS
    ):
        return whole, PREFIXES[unit[0]]
    return known_unit(unit, where), 1.0


def rate_unit(unit: str) -> str:
    """Return the unit of the rate of change of something in `unit`: a known one if it has a name."""
    return {"m/s": "m/s²", "rad/s": "rad/s²", "1": "1/s"}.get(unit, f"{unit}/s")
