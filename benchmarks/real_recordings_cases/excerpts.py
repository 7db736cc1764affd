"""A few seconds of each recording, as recordings of this project, with their licences: small enough for a test or a lesson."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.files.atomic import write_whole
from real_recordings_cases.cases import CASES, Case
from real_recordings_cases.runs import Run, write_recording
from real_recordings_cases.source_files import REPOSITORIES, source_file

ROWS = 600
"""Number of samples of a pendulum's motion: 3 s."""

TOSSES = 3

EXCERPTS = {
    "triple pendulum": "triple_pendulum.csv",
    "robot, pendubot": "pendubot.csv",
    "cube tosses": "cube_tosses.csv",
}
"""By the name of a case, what its excerpt is called."""


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
    parts = [
        "Excerpts of recordings published by others, resampled and renamed; not part of this project."
    ]
    for repository in REPOSITORIES:
        place = f"github.com/{repository.owner}/{repository.name} at {repository.commit}"
        text = source_file(repository, "LICENSE").read(data).decode()
        parts.append(f"{place}, {repository.licence}:\n\n{text.strip()}")
    return "\n\n\n".join(parts) + "\n"
