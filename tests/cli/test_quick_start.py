"""What makes commands start quickly changes nothing but that."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from neuroanimator.cli.quick_start import amd_plugins
from neuroanimator.zoo import shipped_policy


def test_jaxs_plugins_are_found_by_their_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "jax_rocm7_plugin-0.10.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: jax-rocm7-plugin\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    names = [package.metadata["Name"] for package in amd_plugins(metadata.distributions)]
    assert "jax-rocm7-plugin" in names
    assert len(names) < len(list(metadata.distributions()))


def test_imported_quickly_jax_is_whole_and_packages_are_found_again():
    program = (
        "from importlib import metadata; before = metadata.distributions\n"
        "from neuroanimator.cli.quick_start import import_jax_quickly; import_jax_quickly()\n"
        "import jax.numpy; assert metadata.distributions is before\n"
        "print(int(jax.numpy.arange(4).sum()))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "6\n", done.stderr


@pytest.mark.parametrize(
    "verb", [("list",), ("info", "fish-50"), ("info", "fish.policy.safetensors")]
)
def test_what_ships_is_told_of_without_jax_and_physics(verb: tuple[str, ...]):
    arguments = [str(shipped_policy("fish")) if "policy" in word else word for word in verb]
    program = (
        f"import sys; sys.argv = ['neuroanimator', *{arguments}]\n"
        "from neuroanimator.cli.main import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([name for name in ('jax', 'mujoco') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr
