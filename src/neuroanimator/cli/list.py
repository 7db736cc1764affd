"""The verb `list`: print the systems, and the emulators and policies that ship."""

from __future__ import annotations

from neuroanimator.files.zoo import (
    POLICIES,
    SHIPPED,
    SHIPPED_SYSTEMS,
    SOFT,
    WITHOUT_EMULATOR,
    emulator_name,
    shipped_path,
    shipped_policy,
)
from neuroanimator.systems import goal_names
from neuroanimator.terminal import print_rows

EXAMPLE = "neuroanimator list"


def run() -> None:
    """List the systems and the ready-made emulators and policies."""
    print("Systems")
    print_rows((f"  {name}", system.about) for name, system in SHIPPED_SYSTEMS.items())
    print("\nGoals for 'control'")
    print_rows(
        (f"  {name}", ", ".join(goals)) for name in SHIPPED_SYSTEMS if (goals := goal_names(name))
    )
    print("\nReady-made emulators")
    emulator_rows = []
    for system, substeps in sorted(SHIPPED + SOFT):
        for size, text in (
            ("", f"leaps {substeps} physics steps at a time"),
            ("large", "the same, slower and more accurate"),
        ):
            if shipped_path(system, substeps, size).is_file():
                emulator_rows.append((f"  {emulator_name(system, substeps, size)}", text))
    emulator_rows += [
        (f"  {system}", "none: stepping its physics costs less; 'train' makes one")
        for system in WITHOUT_EMULATOR
    ]
    print_rows(emulator_rows)
    print("\nReady-made policies (Python: load_policy)")
    print_rows(
        (f"  {system}", f"swims by commands, speed and turn, through {_usual(system)}")
        for system in POLICIES
        if shipped_policy(system).is_file()
    )


def _usual(system: str) -> str:
    """Return the name of a system's usual emulator."""
    return emulator_name(system, SHIPPED_SYSTEMS[system].substeps[0])
