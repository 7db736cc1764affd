"""Parameters from the tables of a definition."""

from __future__ import annotations

from neuroanimator.definitions.parameter import ParameterTable
from neuroanimator.errors import ArgumentError
from neuroanimator.state.parameters import Parameter


def parameter_from_table(name: str, table: ParameterTable, unit: str, own: float) -> Parameter:
    """Return the parameter that a table describes, with the value `own` if the table gives none.

    Raises ArgumentError for a nominal value outside the range.
    """
    low, high = table.range
    nominal = own if table.nominal is None else table.nominal
    if not low <= nominal <= high:
        raise ArgumentError(
            f"parameters.{name}.range: wanted one around the body's own value, {nominal:g} {unit}, got {low:g} to {high:g}. "
            "Widen it, or give nominal = … within it."
        )
    return Parameter(name, unit, low, high, nominal)
