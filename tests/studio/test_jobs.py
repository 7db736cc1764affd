"""Trainings from the page: they outlive the server, stop at once, and go on where they were."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from serving import Serving, ask_page, serving
from waiting import PATIENCE, wait_until

from neuroanimator import load_emulator
from neuroanimator.errors import BadFileError
from neuroanimator.learn.training.train import run_folder
from neuroanimator_studio import models
from neuroanimator_studio.job_plan import checked_plan
from neuroanimator_studio.job_settings import data_of
from neuroanimator_studio.job_worker import OUT, RUN
from neuroanimator_studio.jobs import Jobs, running_process

ARM = b"""<mujoco><worldbody><body><joint name="hinge" type="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.04"/></body></worldbody>
<actuator><motor name="motor" joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>"""


def the_job(jobs: Jobs) -> dict[str, Any]:
    (row,) = jobs.list()
    return row


def test_a_training_outlives_the_server_is_stopped_and_goes_on(tmp_path: Path):
    with serving(tmp_path) as studio, studio.page() as page:
        answer = ask_page(page, do="train", system="pendulum", substeps=50, count=2_000_000)
        job = answer["job"]
        assert [row["id"] for row in answer["jobs"]] == [job]
        wait_until(lambda: the_job(studio.studio.jobs)["phase"] == "data")
        process = running_process(studio.studio.jobs.folder / job)
        assert process is not None
        while json.loads(page.recv(PATIENCE)).get("event") != "job":
            pass
    # The server is gone, the job is not.
    os.kill(process, 0)
    with serving(tmp_path) as studio, studio.page() as page:
        jobs = studio.studio.jobs
        assert ask_page(page, do="jobs")["jobs"][0]["is_running"]
        wait_until(lambda: the_job(jobs)["done"] > 0)
        stopped = ask_page(page, do="stop", job=job)["jobs"][0]
        assert stopped["phase"] == "stopped"
        assert not stopped["is_running"]
        shards = len(list((jobs.folder / job / "data").glob("*.safetensors")))
        resumed = ask_page(page, do="resume", job=job)["jobs"][0]
        assert resumed["phase"] in ("starting", "data")
        wait_until(lambda: the_job(jobs)["done"] > shards)
        assert "error" in ask_page(page, do="forget", job=job)
        ask_page(page, do="stop", job=job)
        assert ask_page(page, do="forget", job=job)["jobs"] == []
        assert not list(jobs.folder.iterdir())


def test_a_killed_training_is_seen_to_be_stopped(tmp_path: Path):
    jobs = Jobs(tmp_path, tmp_path)
    job = jobs.start(checked_plan({"system": "pendulum", "substeps": 50, "count": 2_000_000}))
    wait_until(lambda: the_job(jobs)["phase"] == "data")
    process = running_process(tmp_path / job)
    assert process is not None
    os.kill(process, signal.SIGKILL)
    wait_until(lambda: the_job(jobs)["phase"] == "stopped")


def test_a_curve_is_looked_for_where_training_writes_it(tmp_path: Path):
    assert run_folder(tmp_path / OUT) == tmp_path / RUN


@pytest.mark.endurance
def test_a_training_ends_as_an_emulator_on_show(tmp_path: Path):
    with serving(tmp_path) as studio, studio.page() as page:
        answer = ask_page(page, do="train", system="pendulum-passive", count=7_200, updates=500)
        jobs = studio.studio.jobs
        wait_until(lambda: the_job(jobs)["phase"] in ("done", "failed"))
        row = the_job(jobs)
        assert row["phase"] == "done", row
        assert row["curve"][-1][0] == 500
        assert row["bundle"] in [
            entry["id"] for entry in studio.ask("/catalogue.json").json["entries"]
        ]
        emulator = load_emulator(str(jobs.folder / answer["job"] / "job.emulator.safetensors"))
        assert emulator.system == "pendulum-passive"


@pytest.fixture(scope="module")
def arm(studio: Serving) -> dict[str, Any]:
    """What the page is told of a model that was dropped on it."""
    reply = studio.post("/api/models", ARM, "application/octet-stream", {"X-Name": "my%20arm"})
    assert reply.status == 200, reply.body
    return reply.json


def test_a_dropped_model_becomes_a_system_to_train(studio: Serving, arm: dict[str, Any]):
    assert arm["system"] == "my_arm"
    assert arm["dt"] > 0
    model = studio.studio.models.find(arm["model"])
    plan = checked_plan({"system": "my_arm", "substeps": arm["substeps"], "size": "sketch"})
    folder = model.toml.parent
    model.toml.with_name("model.toml").write_bytes(model.toml.read_bytes())
    assert data_of(plan, folder).count == 30_000
    assert "my_arm" in data_of(plan, folder).definition


def test_s06_a_model_without_an_end_is_given_up_by_processor_time(
    monkeypatch: pytest.MonkeyPatch,
):
    endless = f"{models.LIMITED.format(1)}while True: pass"
    monkeypatch.setattr(models, "COMMAND_LINE", endless)
    with pytest.raises(BadFileError, match="took too long"):
        models.Models().add(ARM, "arm")


def test_s06_what_is_no_model_is_refused_in_one_line(studio: Serving):
    hostile = {
        "nothing": b"",
        "a script": b"import os\nos.system('true')",
        "another xml": b"<html><body/></html>",
        "include outside": b'<mujoco><include file="../../../../etc/passwd"/></mujoco>',
        "bomb": b'<!DOCTYPE m [<!ENTITY a "'
        + b"a" * 1000
        + b'"><!ENTITY b "'
        + b"&a;" * 1000
        + b'">]><mujoco>&b;</mujoco>',
    }
    for name, content in hostile.items():
        reply = studio.post(
            "/api/models", content, "application/octet-stream", {"X-Name": "../evil"}
        )
        assert reply.status == 400, (name, reply.body)
        error = reply.json["error"]
        assert len(error.splitlines()) == 1
        assert "root:" not in error
        assert "/tmp" not in error, error


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"do": "train"}, "a system or a model"),
        ({"do": "train", "system": "pendlum"}, "No system called 'pendlum'. Systems: "),
        ({"do": "train", "system": "../x"}, "No system"),
        ({"do": "train", "model": "none"}, "model: none has this id"),
        ({"do": "train", "system": "fish", "substeps": 0}, "substeps"),
        ({"do": "train", "system": "fish", "count": 1}, "count"),
        ({"do": "stop", "job": "../../x"}, "job: none has this id"),
        ({"do": "resume", "job": "0" * 16}, "job: none has this id"),
    ],
)
def test_what_cannot_be_trained_is_said_in_one_line(
    studio: Serving, request_: dict[str, Any], words: str
):
    with studio.page() as page:
        assert words in ask_page(page, **request_)["error"]
    assert not list(studio.studio.jobs.folder.iterdir())
