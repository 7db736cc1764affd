"""`list`: systems, and the emulators and policies that ship."""

from __future__ import annotations

EXAMPLE = "neuroanimator list"


def run() -> None:
    """List the systems and the ready-made emulators and policies."""
    from neuroanimator.systems import SYSTEMS, load_system
    from neuroanimator.terminal import print_rows
    from neuroanimator.zoo import POLICIES, SHIPPED, shipped_path, shipped_policy

    print("Systems")
    print_rows((f"  {name}", text) for name, text in SYSTEMS.items())
    print("\nGoals for 'control'")
    goals = {name: load_system(name).goals for name in SYSTEMS}
    print_rows((f"  {name}", ", ".join(named)) for name, named in goals.items() if named)
    print("\nReady-made emulators")
    present = [(system, n) for system, n in sorted(SHIPPED) if shipped_path(system, n).is_file()]
    print_rows((f"  {system}-{n}", f"leaps {n} physics steps at a time") for system, n in present)
    print("\nReady-made policies (Python: find_policy, load_policy)")
    held = [system for system in POLICIES if shipped_policy(system).is_file()]
    print_rows(
        (f"  {system}", f"swims by commands, speed and turn, through {system}-50")
        for system in held
    )
