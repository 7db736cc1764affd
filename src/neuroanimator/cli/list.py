"""The verb `list`: print the systems, and the emulators and policies that ship."""

from __future__ import annotations

from neuroanimator.files.zoo import (
    LARGE,
    POLICIES,
    SHIPPED,
    SOFT,
    WITHOUT_EMULATOR,
    shipped_path,
    shipped_policy,
)
from neuroanimator.systems import SYSTEMS, goal_names
from neuroanimator.terminal import print_rows

EXAMPLE = "neuroanimator list"


def run() -> None:
    """List the systems and the ready-made emulators and policies."""
    print("Systems")
    print_rows((f"  {name}", text) for name, text in SYSTEMS.items())
    print("\nGoals for 'control'")
    goals = {name: goal_names(name) for name in SYSTEMS}
    print_rows((f"  {name}", ", ".join(named)) for name, named in goals.items() if named)
    print("\nReady-made emulators")
    emulator_rows = []
    for system, substeps in sorted([*SHIPPED, *SOFT]):
        if shipped_path(system, substeps).is_file():
            emulator_rows.append(
                (f"  {system}-{substeps}", f"leaps {substeps} physics steps at a time")
            )
        if (system, substeps) in LARGE and shipped_path(system, substeps, "large").is_file():
            emulator_rows.append(
                (f"  {system}-{substeps}-large", "the same, slower and more accurate")
            )
    for system in WITHOUT_EMULATOR:
        emulator_rows.append(
            (f"  {system}", "none: stepping its physics costs less; 'train' makes one")
        )
    print_rows(emulator_rows)
    print("\nReady-made policies (Python: load_policy)")
    policy_rows = []
    for system in POLICIES:
        if shipped_policy(system).is_file():
            does = f"swims by commands, speed and turn, through {system}-50"
            policy_rows.append((f"  {system}", does))
    print_rows(policy_rows)
