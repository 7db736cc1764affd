"""Episodes as a Minari dataset, read back by Minari itself."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import Emulator, load_system
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.export.minari_dataset import FOLDER_VARIABLE, write_minari


@pytest.fixture
def minari():
    return pytest.importorskip("minari", reason="no Minari: pip install 'neuroanimator[minari]'")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("on_physics", [False, True])
def test_minari_reads_what_the_emulator_or_the_physics_did(
    on_physics: bool, minari, shipped: Emulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    before = os.environ.get(FOLDER_VARIABLE)
    written = write_minari(
        shipped, tmp_path / "episodes", episodes=3, seconds=1.0, on_physics=on_physics
    )
    assert os.environ.get(FOLDER_VARIABLE) == before
    assert [path.name for path in tmp_path.iterdir()] == ["episodes"]
    monkeypatch.setenv(FOLDER_VARIABLE, str(written.folder))
    dataset = minari.load_dataset(written.id)
    steps = round(1.0 / shipped.dt)
    assert (dataset.total_episodes, dataset.total_steps) == (3, 3 * steps)
    assert dataset.storage.metadata["observation_names"] == list(shipped.state.names)
    system = load_system(shipped.system)
    for episode in dataset:
        assert episode.observations.shape == (steps + 1, shipped.state.size)
        assert all(dataset.action_space.contains(action) for action in episode.actions)
        assert episode.truncations.tolist() == [False] * (steps - 1) + [True]
        assert not episode.terminations.any()
        start = episode.observations[0].astype(float)
        controls = episode.actions.astype(float)
        if on_physics:
            runs = system.simulate(start[None], controls[None], shipped.dt, scheme=system.scheme)
            again = runs.states[0]
        else:
            again = np.asarray(shipped.rollout(start, controls))
        np.testing.assert_allclose(episode.observations, again, rtol=0.01, atol=0.01)
    starts = [episode.observations[0] for episode in dataset]
    assert np.ptp(starts, axis=0).max() > 0.1


def test_a_folder_with_something_in_it_and_senseless_numbers_are_refused(
    shipped: Emulator, tmp_path: Path
):
    (tmp_path / "kept").write_text("kept")
    with pytest.raises(ArgumentError, match="has something in it. Name a new folder"):
        write_minari(shipped, tmp_path)
    assert (tmp_path / "kept").read_text() == "kept"
    with pytest.raises(ArgumentError, match="episodes: wanted 1 to 100,000, came 0"):
        write_minari(shipped, tmp_path / "new", episodes=0)
    assert not (tmp_path / "new").exists()


def test_without_minari_one_line_says_what_to_install(
    shipped: Emulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # None in the table of modules is what an import of a missing one meets.
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(ResourceError, match=r"pip install 'neuroanimator\[minari\]'"):
        write_minari(shipped, tmp_path / "new")
    assert not (tmp_path / "new").exists()
