"""Storage of datasets: a folder, or a URL of an object store, read and written through fsspec.

An object is whole or absent, as such stores promise for every write. There are no locks: two processes that write the
same shard write the same bytes, and a folder is claimed by an object that only the first can create. Credentials come
from the environment, where the store's driver looks for them, and are neither kept nor shown.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError, ResourceError
from neuroanimator.text import printable, quoted

SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/")
"""Pattern of a URL's scheme; a drive letter is not one."""

FOLDER_SCHEME = "file"
"""Scheme of a folder of this machine, which is used as one: with locks, and flushed to the disk."""

THIS_MACHINE = ("", "localhost")
"""Names of this machine in a folder's URL (RFC 8089)."""

FLEETING_SCHEME = "memory"
"""Scheme of objects in the memory of the process that wrote them, lost with it."""

EXTRAS = {"s3": "'neuroanimator[s3]'", "s3a": "'neuroanimator[s3]'"}
"""Extras of this package, by scheme."""

DRIVERS = {"gs": "gcsfs", "gcs": "gcsfs", "abfs": "adlfs", "abfss": "adlfs", "az": "adlfs"}
"""Packages for other schemes, by scheme."""

HOW_TO_LOG_IN = (
    "Put credentials into the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY."
)

NO_LOGIN = ("NoCredentials", "PartialCredentials", "CredentialRetrieval", "TokenRetrieval")
"""Parts of the names of errors that drivers raise where there are no credentials."""

REFUSED = (
    "Forbidden",
    "AccessDenied",
    "Unauthorized",
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
)
"""Parts of drivers' messages on refused credentials, where they do not raise PermissionError."""


@dataclass(frozen=True)
class UrlPath:
    """An object of a store, or all objects with this prefix: like a file or a folder on a disk."""

    url: str
    """The URL, without a slash at its end and without credentials."""

    def __str__(self) -> str:
        return self.url

    def __truediv__(self, name: str) -> UrlPath:
        return UrlPath(f"{self.url}/{name}")

    @property
    def name(self) -> str:
        """The name after the last slash."""
        return self.url.rpartition("/")[2]

    @property
    def scheme(self) -> str:
        """The scheme before the colon: the kind of store."""
        return self.url.partition("://")[0]

    def exists(self) -> bool:
        """Return whether there is such an object."""
        with self._told():
            return bool(self._store.exists(self.url))

    def is_file(self) -> bool:
        """Return whether there is such an object."""
        return self.exists()

    def read(self, largest: int) -> bytes:
        """Return the object's bytes; BadFileError if there is none, or more than `largest` [bytes]."""
        try:
            with self._told():
                content = self._store.cat_file(self.url, start=0, end=largest + 1)
        except FileNotFoundError as error:
            raise BadFileError(f"Could not read {self}: no such object. Check the URL.") from error
        if len(content) > largest:
            raise BadFileError(f"{self}: more than {largest:,} bytes.")
        return content

    def write(self, content: bytes) -> None:
        """Write the object: readers find the old one or the new one, nothing else."""
        self._pipe(content)

    def create(self, content: bytes) -> bool:
        """Write the object unless there is one; return whether there was none.

        Of several concurrent calls only one succeeds, if the store guarantees that, as S3 does.
        """
        try:
            self._pipe(content, mode="create")
        except FileExistsError:
            return False
        return True

    def _pipe(self, content: bytes, **options: str) -> None:
        try:
            with self._told():
                self._store.pipe_file(self.url, content, **options)
        except FileNotFoundError as error:
            raise ResourceError(
                f"Could not write {self}: no such bucket. Make it first."
            ) from error

    @property
    def _store(self) -> Any:
        """The driver of the URL's scheme."""
        scheme = self.scheme
        try:
            import fsspec

            return fsspec.filesystem(scheme, use_listings_cache=False)
        except ImportError as error:
            package = EXTRAS.get(scheme) or DRIVERS.get(
                scheme, "the package that fsspec names for it"
            )
            raise ResourceError(
                f"{self}: the driver for {scheme} is not installed. pip install {package}"
            ) from error
        except ValueError as error:
            raise ArgumentError(
                f"{self}: no driver for {quoted(scheme)}. Use s3://, gs:// or az://."
            ) from error

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn the driver's errors into one line without their messages, which might hold keys."""
        try:
            yield
        except (NeuroAnimatorError, FileNotFoundError, FileExistsError):
            raise
        except PermissionError as error:
            raise ResourceError(f"{self}: access refused. {HOW_TO_LOG_IN}") from error
        except Exception as error:
            name = type(error).__name__
            if any(part in name for part in NO_LOGIN):
                raise ResourceError(f"{self}: no credentials. {HOW_TO_LOG_IN}") from error
            if any(part in str(error) for part in REFUSED):
                raise ResourceError(f"{self}: access refused. {HOW_TO_LOG_IN}") from error
            raise ResourceError(
                f"{self}: the store does not answer as it should ({printable(name)}). Check the URL, and try again."
            ) from error


Place = Path | UrlPath
"""Location of a dataset, or of one of its files."""


def is_url(reference: str) -> bool:
    """Return whether a text names an object store, rather than a folder."""
    return "://" in reference or SCHEME.match(reference) is not None


def place_of(reference: str | Path | UrlPath) -> Place:
    """Return the folder or the URL that a user names; ArgumentError for a URL with credentials in it.

    Credentials are never printed: a terminal's lines are kept in many places.
    """
    if isinstance(reference, UrlPath):
        return reference
    if isinstance(reference, Path):
        if is_url(str(reference)):
            raise ArgumentError(
                "A URL was given as a Path, which drops a slash. Give it as a string."
            )
        return reference
    if not is_url(reference):
        return Path(reference)
    scheme, _, rest = reference.partition("://")
    host, slash, path = rest.partition("/")
    _, at, bare_host = host.rpartition("@")
    shown = quoted(f"{scheme}://{bare_host}{slash}{path.partition('?')[0]}")
    if at or "?" in rest:
        raise ArgumentError(
            f"{shown}: the URL holds credentials or a query. {HOW_TO_LOG_IN} Replace the credentials: they were shown."
        )
    if "::" in reference or "#" in rest or not rest.strip("/") or not printable(rest) == rest:
        raise ArgumentError(f"{shown}: wanted a URL such as s3://bucket/folder.")
    if scheme == FOLDER_SCHEME:
        if host not in THIS_MACHINE or not path.strip("/"):
            raise ArgumentError(
                f"{shown}: wanted a folder on this machine, such as file:///home/me/folder."
            )
        return Path(slash + path)
    return UrlPath(reference.rstrip("/"))
