"""Remake the bundles that ship, after an emulator that ships has changed: `python -m neuroanimator_studio.ship [NAME...]`.

With `--facts` only what they say is made anew, and programs stay as they are.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from safetensors.numpy import load_file

from neuroanimator import Emulator
from neuroanimator.authoring import find_emulator, print_line, write_whole
from neuroanimator.control.policies import StatePolicy
from neuroanimator_studio.bundle import (
    bundle_facts,
    load_models,
    make_bundle,
    policy_beside,
    write_facts,
)
from neuroanimator_studio.catalogue import (
    BUNDLE,
    EMULATOR,
    EXAMPLE_BUNDLES,
    PHYSICS_BUNDLES,
    SHIPPED_BUNDLES,
    shipped_folder,
)
from neuroanimator_studio.description import packed
from neuroanimator_studio.physics import physics_facts, write_physics_module

STEPS_BETWEEN = 2
"""Super steps from one state of a recorded fall to the next."""

CHECKOUT = Path(__file__).resolve().parents[2]
"""Root of the checkout that the studio lies in."""


def ship(names: list[str]) -> None:
    """Make the bundles `names` anew, two at a time: while one waits for a compiler, the other is traced."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        for folder in pool.map(_ship_one, names):
            for path in sorted(folder.iterdir()):
                print_line(f"{path.relative_to(shipped_folder())}: {path.stat().st_size:,} bytes")


def _ship_one(name: str) -> Path:
    """Make the bundle `name` anew, and return its folder."""
    folder = shipped_folder() / name
    folder.mkdir(parents=True, exist_ok=True)
    if name in PHYSICS_BUNDLES:
        write_physics_module(name, folder)
        write_facts(physics_facts(name, folder), folder)
    elif name in EXAMPLE_BUNDLES:
        # Made where its model is not beside: nobody who installs the studio has that.
        source = CHECKOUT / EXAMPLE_BUNDLES[name].file
        write_whole(folder / EMULATOR, source.read_bytes())
        make_bundle(str(folder / EMULATOR), folder, name)
        ship_facts([name])
    else:
        make_bundle(name, folder)
    return folder


def ship_facts(names: list[str]) -> None:
    """Make anew what the bundles `names` say."""
    for name in names:
        path = shipped_folder() / name / BUNDLE
        if name in PHYSICS_BUNDLES:
            write_facts(physics_facts(name, path.parent), path.parent)
            continue
        if name in EXAMPLE_BUNDLES:
            write_facts(example_facts(name, path.parent), path.parent)
            continue
        source = find_emulator(name)
        emulator = Emulator.load(source)
        facts = bundle_facts(source, emulator, policy_beside(source, emulator), name)
        write_facts(facts, path.parent)


def example_facts(name: str, folder: Path) -> dict[str, Any]:
    """Return what the bundle of an example says, by the file in its `folder`."""
    source = folder / EMULATOR
    emulator, policy = load_models(source)
    facts = bundle_facts(source, emulator, policy, name)
    example = EXAMPLE_BUNDLES[name]
    facts["scene"]["kind"] = example.scenery
    assert isinstance(policy, StatePolicy)
    falls = describe_falls(CHECKOUT / example.falls, policy)
    return facts | {"title": name, "about": example.about, "falls": falls}


def describe_falls(file: Path, policy: StatePolicy) -> dict[str, Any]:
    """Return the falls in a file that `benchmarks/following/getting_up.py` wrote: states (T, S), `dt` [s] apart, in base64.

    The states are float32. `heading` is the state entry of the commanded heading.
    """
    reference = policy.view.reference
    assert reference is not None
    assert reference.commands is not None
    motions = [packed(states, "<f4") for states in load_file(file).values()]
    return {
        "dt": STEPS_BETWEEN * policy.dt,
        "heading": reference.commands.heading,
        "motions": motions,
    }


if __name__ == "__main__":
    words = sys.argv[1:]
    chosen = [word for word in words if not word.startswith("--")] or [
        *SHIPPED_BUNDLES,
        *PHYSICS_BUNDLES,
        *EXAMPLE_BUNDLES,
    ]
    if "--facts" in words:
        ship_facts(chosen)
    else:
        ship(chosen)
