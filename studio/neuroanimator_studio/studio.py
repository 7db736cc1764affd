"""All that the server knows while it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from neuroanimator_studio.exports import Downloads
from neuroanimator_studio.guard import Gate
from neuroanimator_studio.jobs import Jobs
from neuroanimator_studio.library import Library
from neuroanimator_studio.limits import USUAL, Limits
from neuroanimator_studio.models import Models
from neuroanimator_studio.open_page import Page

Result = TypeVar("Result")

WATCH_SECONDS = 0.5
"""Time between two looks at the trainings [s]."""


class Studio:
    """The page's files, the emulators on show, who is connected, and threads for what takes long."""

    def __init__(
        self,
        gate: Gate,
        page_folder: Path,
        library: Library,
        limits: Limits = USUAL,
        jobs: Jobs | None = None,
    ):
        self.gate = gate
        self.library = library
        self.jobs = jobs or Jobs(library.folder)
        self.models = Models()
        self.limits = limits
        self.page_files = page_files(page_folder)
        self.downloads = Downloads(limits.downloads)
        self.pages: set[Page] = set()
        # One of each: the machine has few cores, and simulators are not made to be shared.
        self._physics = ThreadPoolExecutor(1, "physics")
        self._exporting = ThreadPoolExecutor(1, "exporting")
        self._making = ThreadPoolExecutor(1, "making")
        self._files = ThreadPoolExecutor(1, "files")

    async def in_physics(self, work: Callable[[], Result]) -> Result:
        """Return what `work` does beside the server, after what was asked before."""
        return await asyncio.get_running_loop().run_in_executor(self._physics, work)

    async def in_exporting(self, work: Callable[[], Result]) -> Result:
        """Return what `work` does, as `in_physics`; what takes long waits for its like only."""
        return await asyncio.get_running_loop().run_in_executor(self._exporting, work)

    async def in_making(self, work: Callable[[], Result]) -> Result:
        """Return what `work` does, as `in_physics`; for what waits for a process that works on somebody's file.

        Nobody who drops a file waits for an export.
        """
        return await asyncio.get_running_loop().run_in_executor(self._making, work)

    async def in_files(self, work: Callable[[], Result]) -> Result:
        """Return what `work` does, as `in_physics`; for what only looks at files and processes."""
        return await asyncio.get_running_loop().run_in_executor(self._files, work)

    async def watch_jobs(self) -> None:
        """Tell the pages how far the trainings are, as long as there are pages, whenever something has changed."""
        told: dict[str, Any] = {}
        while True:
            await asyncio.sleep(WATCH_SECONDS)
            if not self.pages:
                continue
            rows = await self.in_files(self.jobs.list)
            now = {row["id"]: row for row in rows}
            for job_id, row in now.items():
                if told.get(job_id) != row:
                    self.tell_pages({"event": "job", **row})
                    if row["phase"] == "done" and told.get(job_id, row)["phase"] != "done":
                        self.tell_pages({"event": "catalogue"})
            told = now

    def tell_pages(self, event: dict[str, Any]) -> None:
        """Tell all pages of something."""
        for page in list(self.pages):
            page.tell(event)

    def close(self) -> None:
        """Wait for nothing that still runs."""
        self._physics.shutdown(wait=False, cancel_futures=True)
        self._exporting.shutdown(wait=False, cancel_futures=True)
        self._making.shutdown(wait=False, cancel_futures=True)
        self._files.shutdown(wait=False, cancel_futures=True)


def page_files(folder: Path) -> dict[str, Path]:
    """Return every file of the built page by its path in the URL; links are left out, and nothing else is ever served."""
    files = {}
    for path in sorted(folder.rglob("*")):
        is_within = path.resolve().is_relative_to(folder.resolve())
        if path.is_file() and not path.is_symlink() and is_within:
            files[f"/{path.relative_to(folder).as_posix()}"] = path
    return files
