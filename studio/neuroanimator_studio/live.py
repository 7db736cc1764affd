"""What a page and the server say to each other while the page is open: questions about the physics, answers, events.

A page that floods the server, asks what is no JSON or takes nothing in is left; the server waits for nobody.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import numpy as np
from starlette.responses import JSONResponse
from starlette.websockets import WebSocket, WebSocketDisconnect

import neuroanimator
from neuroanimator import ArgumentError, NeuroAnimatorError
from neuroanimator_studio.descents import judge_motion
from neuroanimator_studio.description import packed
from neuroanimator_studio.drive import checked_drive, checked_states
from neuroanimator_studio.job_plan import check_packaged, checked_plan
from neuroanimator_studio.judge import judge, replay_physics
from neuroanimator_studio.library import Shown
from neuroanimator_studio.open_page import Budget, Page, RefusedError
from neuroanimator_studio.requests import (
    Asked,
    Jobs,
    Judge,
    JudgeDescent,
    OfJob,
    Replay,
    Train,
    read_request,
    request_id,
)
from neuroanimator_studio.studio import Studio
from neuroanimator_studio.words import public_words, say_unexpected

POLICY_VIOLATION = 1008
"""The code with which a socket is closed that does what it may not (RFC 6455, 7.4.1)."""

CLOSING_SECONDS = 1.0
"""Time for a page to be told why it is left [s]."""

Answer = dict[str, Any]


async def serve_page(socket: WebSocket) -> None:
    """Talk to one page until it is gone."""
    studio: Studio = socket.app.state.studio
    if len(studio.pages) >= studio.limits.sockets:
        words = f"{studio.limits.sockets} pages are open already. Close one and reload."
        await socket.send_denial_response(JSONResponse({"error": words}, 503))
        return
    page = Page(socket, studio.limits)
    studio.pages.add(page)
    try:
        # A browser hears which of its subprotocols was taken; it offers the token alone.
        await socket.accept(socket.scope["subprotocols"][0])
        await _talk(studio, page)
    except* RefusedError as refusals:
        # Who takes nothing in may not take this in, either.
        with contextlib.suppress(Exception):
            async with asyncio.timeout(CLOSING_SECONDS):
                await socket.close(POLICY_VIOLATION, str(refusals.exceptions[0]))
    except* WebSocketDisconnect:
        pass
    finally:
        studio.pages.discard(page)


async def _talk(studio: Studio, page: Page) -> None:
    """Send, read and work until one of them ends by an error, which ends the others."""
    page.tell({"event": "ready", "version": neuroanimator.__version__})
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(page.send_all())
        tasks.create_task(_read(studio, page, tasks))


async def _read(studio: Studio, page: Page, tasks: asyncio.TaskGroup) -> None:
    """Read requests and have them worked on, a few at a time."""
    budget = Budget(studio.limits)
    free = asyncio.Semaphore(studio.limits.requests_at_once)
    while True:
        text = await page.receive()
        budget.spend()
        await free.acquire()
        task = tasks.create_task(_work(studio, page, text))
        task.add_done_callback(lambda _: free.release())


async def _work(studio: Studio, page: Page, text: str) -> None:
    """Answer one request; whatever is wrong with it is said in one line."""
    await page.answer(await answer_to(studio, text))


async def answer_to(studio: Studio, text: str) -> Answer:
    """Return the answer to one request. Raises RefusedError for what is no JSON."""
    most = studio.limits.message_bytes
    try:
        # Beside the server: a message may be long.
        request = await asyncio.to_thread(read_request, text, most)
    except ArgumentError as error:
        number = await asyncio.to_thread(request_id, text, most)
        return {"id": number, "error": public_words(str(error))}
    except (ValueError, RecursionError) as error:
        raise RefusedError("no JSON") from error
    try:
        answer = await _carried_out(studio, request)
    except NeuroAnimatorError as error:
        return {"id": request.id, "error": public_words(str(error))}
    except Exception as error:
        return {"id": request.id, "error": say_unexpected(error)}
    return {"id": request.id, **answer}


async def _carried_out(studio: Studio, request: Asked) -> Answer:
    """Return what was asked for, computed beside the server."""
    if isinstance(request, Replay):
        return await studio.in_physics(lambda: replayed(studio, request))
    if isinstance(request, Judge):
        return await studio.in_physics(lambda: judged(studio, request))
    if isinstance(request, JudgeDescent):
        return await studio.in_physics(lambda: descent_judged(studio, request))
    return await studio.in_files(lambda: job_answer(studio, request))


def replayed(studio: Studio, request: Replay) -> Answer:
    """Return the answer to `replay`."""
    shown = studio.library.load(request.bundle)
    drive = checked_drive(shown.spec, request, studio.limits)
    result = replay_physics(shown, drive, studio.limits)
    return {
        "states": packed(result.states, "<f4"),
        "wall_s": result.wall_s,
        "usual_wall_s": result.usual_wall_s,
        "physics_steps": result.physics_steps,
    }


def judged(studio: Studio, request: Judge) -> Answer:
    """Return the answer to `judge`."""
    shown = studio.library.load(request.bundle)
    verdict = judge(shown, request.goal, _last_state(shown, request), request.target)
    return verdict._asdict()


def descent_judged(studio: Studio, request: JudgeDescent) -> Answer:
    """Return the answer to `judge_descent`."""
    shown = studio.library.load(request.bundle)
    states = checked_states(shown.spec, request.states)
    if shown.emulator is None:
        raise ArgumentError(f"{shown.bundle_id} has no emulator, and so no descents to judge.")
    return judge_motion(shown.emulator, shown.system, request.values, states)._asdict()


def job_answer(studio: Studio, request: Train | Jobs | OfJob) -> Answer:
    """Return the answer to what is asked of trainings: all of them, as they are then."""
    answer: Answer = {}
    if isinstance(request, Train):
        answer["job"] = started(studio, request)
    elif isinstance(request, OfJob):
        actions = {
            "stop": studio.jobs.stop,
            "resume": studio.jobs.resume,
            "forget": studio.jobs.forget,
        }
        actions[request.do](request.job)
    answer["jobs"] = studio.jobs.list()
    return answer


def started(studio: Studio, request: Train) -> str:
    """Return the id of the training that now runs."""
    values = request.model_dump(include={"substeps", "size", "count", "updates"})
    if (request.system is None) == (request.model is None):
        raise ArgumentError("train: wanted a system or a model, one of them.")
    if request.model is not None:
        model = studio.models.find(request.model)
        return studio.jobs.start(
            checked_plan({"system": model.facts["system"], **values}), model.toml
        )
    check_packaged(request.system or "")
    return studio.jobs.start(checked_plan({"system": request.system, **values}))


def _last_state(shown: Shown, request: Judge) -> np.ndarray:
    """Return the last of the states."""
    return checked_states(shown.spec, request.states)[-1]
