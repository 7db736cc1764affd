"""A few seconds of each recording, as recordings of this project, with their licences: small enough for a test or a lesson."""

from __future__ import annotations

from pathlib import Path

from benchmarks.real_recordings.cases import CASES, Case
from benchmarks.real_recordings.runs import Run, write_recording
from benchmarks.real_recordings.source_files import REPOSITORIES, source_file
from neuroanimator.files.atomic import write_whole

ROWS = 400
"""Number of samples of a pendulum's motion: 2 s."""

TOSSES = 2

EXCERPTS = {
    "triple pendulum": "triple_pendulum.csv",
    "robot, pendubot": "pendubot.csv",
    "cube tosses": "cube_tosses.csv",
}
"""By the name of a case, what its excerpt is called."""

ORIGIN = """\
Excerpts of recordings published by others, resampled and renamed; not part of this project. Each is written by
real_recordings.py --excerpts; columns are named in the first line, with units.

triple_pendulum.csv: the first 2 s of the free swing of dynamicslab/MultiArm-Pendulum, every 5 ms. Angles are those of hinges,
zero when hanging, as measured; velocities are slopes of a cubic over 30 ms.
pendubot.csv: the first 2 s of a swing-up by the shoulder's motor of dfki-ric-underactuated-lab/double_pendulum, every 5 ms.
Velocities are slopes over 50 ms; torques are means over the next 5 ms, from the motors' currents.
cube_tosses.csv: two tosses of DAIRLab/contact-nets, 148 samples a second: position, orientation (wxyz), velocity, angular
velocity in the cube's own axes."""


def write_excerpts(folder: Path, data: Path) -> None:
    """Write the beginning of each case's training part, and LICENCES.txt, which says where they come from."""
    folder.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        if case.name in EXCERPTS:
            training, _ = case.read(data)
            runs = _beginning(case, training)
            write_recording(folder / EXCERPTS[case.name], runs, case.columns, case.dt)
    write_whole(folder / "LICENCES.txt", _licences(data).encode())


def _beginning(case: Case, runs: list[Run]) -> list[Run]:
    if case.is_cube:
        return runs[:TOSSES]
    first = runs[0]
    return [Run(first.name, first.states[:ROWS], first.controls[:ROWS])]


def _licences(data: Path) -> str:
    parts = [ORIGIN]
    for repository in REPOSITORIES:
        place = f"github.com/{repository.owner}/{repository.name} at {repository.commit}"
        text = source_file(repository, "LICENSE").read(data).decode()
        parts.append(f"{place}, {repository.licence}:\n\n{text.strip()}")
    return "\n\n\n".join(parts) + "\n"
