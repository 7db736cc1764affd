"""The authors' files: where they are published, and how they come here, each checked by its sha256.

They are not part of this project. `files.sha256` lists them as `sha256sum` does, by repository and path; they come from
their public address, pinned to a commit, or lie in a folder of checkouts (`--data FOLDER`, which holds
`MultiArm-Pendulum`, `double_pendulum` and `contact-nets`).
"""

from __future__ import annotations

import hashlib
import urllib.parse
import urllib.request
from pathlib import Path
from typing import NamedTuple

from neuroanimator.files.atomic import write_whole

LIST = Path(__file__).parent / "files.sha256"

SECONDS = 60
"""A file that takes longer than this to arrive is given up [s]."""


class Repository(NamedTuple):
    """A public repository at one commit."""

    owner: str
    name: str
    commit: str
    licence: str

    def address(self, path: str) -> str:
        """Return the public address of a file."""
        quoted = urllib.parse.quote(path)
        return f"https://raw.githubusercontent.com/{self.owner}/{self.name}/{self.commit}/{quoted}"


REPOSITORIES = (
    Repository(
        "dynamicslab",
        "MultiArm-Pendulum",
        "e99a7e13fe2adc8fc647321a156b6cb59a48a698",
        "MIT",
    ),
    Repository(
        "dfki-ric-underactuated-lab",
        "double_pendulum",
        "1e8544e67f3da72a51ee52fbbb278e131ce2a43f",
        "BSD-3-Clause",
    ),
    Repository(
        "DAIRLab",
        "contact-nets",
        "c3dc21c94577ff4ed99123f0b00bfe57bb2d1d90",
        "BSD-3-Clause",
    ),
)

MULTI_ARM, ROBOT, TOSSES = REPOSITORIES


class SourceFile(NamedTuple):
    """A file of a repository and the digest of its bytes."""

    repository: Repository
    path: str
    sha256: str

    def read(self, data: Path) -> bytes:
        """Return the file's bytes from a folder of checkouts; ValueError if they are others than they were."""
        content = (data / self.repository.name / self.path).read_bytes()
        check(content, self)
        return content


def check(content: bytes, file: SourceFile) -> None:
    """Raise ValueError unless these are the bytes every figure was measured with."""
    digest = hashlib.sha256(content).hexdigest()
    if digest != file.sha256:
        raise ValueError(f"{file.path}: sha256 {digest}, wanted {file.sha256}")


def source_files(repository: Repository, folder: str = "") -> list[SourceFile]:
    """Return the listed files of a repository that lie below `folder`, in order of their paths."""
    files = []
    for line in LIST.read_text(encoding="utf-8").splitlines():
        digest, _, place = line.partition("  ")
        name, _, path = place.partition("/")
        if name == repository.name and path.startswith(folder):
            files.append(SourceFile(repository, path, digest))
    return files


def source_file(repository: Repository, path: str) -> SourceFile:
    """Return one listed file; ValueError if it is not listed."""
    for file in source_files(repository, path):
        if file.path == path:
            return file
    raise ValueError(
        f"{repository.name}/{path} is not in {LIST.name}: add it there with its sha256"
    )


def fetch(data: Path) -> None:
    """Put every listed file that is not in the folder there, from its public address."""
    for repository in REPOSITORIES:
        for file in source_files(repository):
            target = data / repository.name / file.path
            if target.exists():
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            address = repository.address(file.path)
            with urllib.request.urlopen(address, timeout=SECONDS) as answer:
                content = answer.read()
            check(content, file)
            write_whole(target, content)
