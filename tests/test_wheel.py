"""The wheel is all that is needed: installed outside the checkout it works, without a compiler and without a display."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from test_documentation import blocks_of
from waiting import PATIENCE

from neuroanimator.cli import studio
from neuroanimator.errors import ResourceError
from neuroanimator.files.zoo import SHIPPED, shipped_path
from neuroanimator_studio.catalogue import shipped_bundles

CHECKOUT = Path(__file__).parents[1]
PACKAGE = CHECKOUT / "src" / "neuroanimator"
STUDIO = CHECKOUT / "studio" / "neuroanimator_studio"

MAX_WHEEL = 15_000_000
"""[bytes]"""

PACKAGED = (
    "*.py", "*.c", "*.h", "*.js", "*.ts", "*.toml", "*.xml", "*.safetensors", "*.json", "*.wasm", "*.html", "*.css", "*.svg",
    "*.md",
)  # fmt: skip
"""What the wheel holds all files of: the studio's built page, too, where it is built."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as `make wheel` builds it."""
    return built_wheel(CHECKOUT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def studio_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The studio's wheel as `make wheel` builds it."""
    return built_wheel(STUDIO.parent, tmp_path_factory.mktemp("studio-wheel"))


def built_wheel(project: Path, folder: Path) -> Path:
    """Build the wheel of a project into an empty folder; return its file."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=project, check=True, capture_output=True)
    (file,) = folder.iterdir()
    return file


def empty_environment(folder: Path, *, with_pip: bool = True) -> Path:
    """Make an environment without packages, but pip if need be, in `folder`; return where its programs are."""
    without = [] if with_pip else ["--without-pip"]
    subprocess.run([sys.executable, "-m", "venv", *without, str(folder)], check=True)
    return folder / "bin"


def has_pip() -> bool:
    """Return whether this environment has a pip: one that uv made has none."""
    return importlib.util.find_spec("pip") is not None


def run_installed(programs: Path, cwd: Path, *arguments: str) -> str:
    """Run the installed command line where nothing else can be found: no compiler, no display, no home."""
    home = cwd / "home"
    home.mkdir(exist_ok=True)
    wanted = ("LD_LIBRARY_PATH", "XLA_FLAGS")
    kept = {key: os.environ[key] for key in wanted if key in os.environ}
    result = subprocess.run(
        [str(programs / "neuroanimator"), *arguments],
        cwd=cwd,
        env=kept | {"PATH": str(programs), "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def check_installed(programs: Path, cwd: Path) -> None:
    """Fail unless what is installed comes from the wheel and can list, look around and animate."""
    where = "import neuroanimator; print(neuroanimator.__file__)"
    imported = subprocess.run(
        [str(programs / "python"), "-c", where], cwd=cwd, env={}, capture_output=True, text=True
    )
    assert Path(imported.stdout.strip()).is_relative_to(programs.parent), imported.stderr
    assert "dolphin" in run_installed(programs, cwd, "list")
    assert "neuroanimator" in run_installed(programs, cwd, "doctor")
    run_installed(programs, cwd, "animate", "pendulum", "--seconds", "0.2", "--out", "swing.glb")
    assert (cwd / "swing.glb").read_bytes()[:4] == b"glTF"


def check_studio(programs: Path, cwd: Path) -> None:
    """Fail unless the installed studio writes its page, where `make page` has been."""
    if (STUDIO / "page" / "index.html").is_file():
        run_installed(programs, cwd, "studio", "--export", "site")
        assert (cwd / "site" / "index.html").is_file()
        for name in ("fish-50", "human"):
            assert (cwd / "site" / "bundles" / name / "emulator.wasm").is_file()


def check_content(wheel: Path, package: Path) -> set[str]:
    """Fail unless a wheel holds its package's files and nothing else, and no tests; return their names."""
    assert wheel.stat().st_size <= MAX_WHEEL
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    expected = {
        path.relative_to(package.parent).as_posix()
        for pattern in PACKAGED
        for path in package.rglob(pattern)
    }
    assert expected <= names
    own = (f"{package.name}/", f"{package.name}-")
    assert not [name for name in names if not name.startswith(own) or "test_" in name]
    return names


def test_the_wheel_holds_the_package_and_nothing_else(wheel: Path):
    names = check_content(wheel, PACKAGE)
    assert {f"neuroanimator/emulators/{shipped_path(*row).name}" for row in SHIPPED} <= names


def test_the_wheel_of_the_studio_holds_its_page_and_its_bundles(studio_wheel: Path):
    names = check_content(studio_wheel, STUDIO)
    for folder in shipped_bundles():
        assert f"neuroanimator_studio/bundles/{folder.name}/bundle.json" in names


def test_without_its_package_the_studio_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(studio, "GROUP", "nobody.s.group")
    with pytest.raises(ResourceError, match="make wheels"):
        studio.installed_studio()


def test_the_installed_wheel_needs_no_checkout_no_compiler_and_no_display(
    wheel: Path, studio_wheel: Path, tmp_path: Path
):
    programs = empty_environment(tmp_path / "environment", with_pip=not has_pip())
    pip = [str(programs / "python"), "-m", "pip"]
    if has_pip():  # to give the new environment one of its own takes longer than all else here
        pip = [sys.executable, "-m", "pip", "--python", str(programs / "python")]
    # Most of the modules are never imported here.
    install = [*pip, "install", "--quiet", "--no-compile", "--no-index", "--no-deps"]
    subprocess.run([*install, str(wheel), str(studio_wheel)], check=True, env={})
    # The dependencies are those of this environment; its own link to the checkout is not followed from there.
    paths = sysconfig.get_paths(
        vars={"base": str(programs.parent), "platbase": str(programs.parent)}
    )
    dependencies = Path(paths["purelib"]) / "dependencies.pth"
    dependencies.write_text(sysconfig.get_paths()["purelib"] + "\n")
    check_installed(programs, tmp_path)
    check_studio(programs, tmp_path)


@pytest.mark.endurance
def test_the_first_block_of_the_readme_runs_as_written(tmp_path: Path):
    checkout = tmp_path / "checkout"
    left_out = shutil.ignore_patterns(".git", ".venv", "node_modules", "out", "site", "__pycache__")
    shutil.copytree(CHECKOUT, checkout, ignore=left_out, symlinks=True)  # keeps times, for make
    (checkout / ".venv").symlink_to(CHECKOUT / ".venv")
    assert (CHECKOUT / ".venv" / ".ready").is_file()  # else make would set it up, of the copy
    programs = empty_environment(tmp_path / "environment")
    (block, *_) = blocks_of(checkout / "README.md")
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}
    subprocess.run(["bash", "-ec", block.code], cwd=checkout, env=environment, check=True)
    assert (programs / "neuroanimator").is_file()
    assert (checkout / "swim.glb").read_bytes()[:4] == b"glTF"


@pytest.mark.endurance
def test_the_wheel_with_all_it_depends_on_installs_into_an_empty_environment(
    wheel: Path, studio_wheel: Path, tmp_path: Path
):
    programs = empty_environment(tmp_path / "environment")
    pip = [str(programs / "python"), "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, str(wheel)], check=True)
    check_installed(programs, tmp_path)
    subprocess.run([*pip, str(studio_wheel)], check=True)
    check_studio(programs, tmp_path)
