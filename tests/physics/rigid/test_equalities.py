"""States that are drawn, typed, scattered or designed satisfy a model's equality constraints, as MuJoCo's own motions do."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from closed_chains import FINGERS, FOUR_BAR, GAP, MODELS, assert_closed, system_of

from neuroanimator import NeuroAnimatorError
from neuroanimator.definitions.model import Definition
from neuroanimator.learn.data.sampling import runs_near, sample_starts
from neuroanimator.physics.rigid.equalities import close_states
from neuroanimator.physics.rigid.model_system import ModelSystem


def random_loop(rng: np.random.Generator) -> str:
    """Return a chain of random links whose end is tied to the world or to its first link, where it is at first."""
    count = int(rng.integers(3, 7))
    chain = ""
    for number in range(count):
        kind = rng.choice(["hinge", "hinge", "slide", "ball"])
        axis = " ".join(f"{x:.3f}" for x in rng.normal(size=3))
        place = " ".join(f"{x:.3f}" for x in rng.normal(size=3) * 0.3)
        chain += (
            f'<body name="b{number}" pos="{place}"><joint name="j{number}" type="{kind}" axis="{axis}"/>'
            f'<geom size="0.02" pos="0.1 0 0"/>'
        )
    other = str(rng.choice(["world", "b0"]))
    tie = str(rng.choice(["connect", "weld"])) if count > 4 else "connect"
    anchor = "0.1 0.05 0"
    return (
        f"<worldbody>{chain}{'</body>' * count}</worldbody>"
        f'<equality><{tie} name="loop" body1="b{count - 1}" body2="{other}" anchor="{anchor}"/></equality>'
    )


@pytest.mark.parametrize("kind", MODELS)
def test_every_start_satisfies_the_equalities_of_its_model(kind: str):
    system = system_of(MODELS[kind], reset_share=0.3, reset_noise=0.1, rest_share=0.2)
    assert_closed(system, system.rest[None])
    starts = sample_starts(system, np.random.default_rng(0), 100)
    assert_closed(system, starts)
    # They still cover what the joints can do.
    assert starts[:, 0].std() > 0.15
    assert np.isfinite(starts).all()


def test_random_loops_are_closed():
    rng = np.random.default_rng(1)
    for _ in range(15):
        system = system_of(random_loop(rng))
        assert_closed(system, system.sample_starts(rng, 5))


def test_sparse_jacobians_close_loops_as_dense_ones_do():
    dense = system_of(MODELS["parallel robot"])
    sparse = system_of('<option jacobian="sparse"/>' + MODELS["parallel robot"])
    assert mujoco.mj_isSparse(sparse.model)
    first, second = (one.sample_starts(np.random.default_rng(0), 5) for one in (dense, sparse))
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_a_loop_keeps_the_way_it_is_assembled():
    system = system_of(FOUR_BAR)
    starts = system.sample_starts(np.random.default_rng(0), 300)
    motors = np.random.default_rng(1).uniform(-0.2, 0.2, (30, 200, 1))
    runs = system.simulate(np.repeat(system.rest[None], 30, axis=0), motors, 0.02)
    assert not runs.has_diverged.any()
    rocker = runs.states[..., 2]
    # Assembled the other way, the rocker would hang below its bearing.
    assert starts[:, 2].min() > rocker.min() - 0.05
    assert starts[:, 2].max() < rocker.max() + 0.05


def test_followers_move_to_their_leader_and_not_it_to_them():
    system = system_of(FINGERS)
    starts = system.sample_starts(np.random.default_rng(0), 300)
    left = starts[:, 0]
    assert left.min() < 0.05
    assert left.max() > 0.75
    np.testing.assert_allclose(starts[:, 1], 0.05 - left, atol=1e-6)
    np.testing.assert_allclose(system.rest[:2], [0.0, 0.05], atol=1e-4)


def test_what_is_closed_stays_as_it_is():
    system = system_of(FOUR_BAR)
    starts = system.sample_starts(np.random.default_rng(0), 50)
    again = close_states(system.model_of, starts)
    assert again.is_closed.all()
    np.testing.assert_allclose(again.states, starts, atol=1e-9)


def test_a_model_without_equalities_draws_as_before():
    free = system_of(FOUR_BAR.replace("<connect", '<connect active="false"'))
    assert not free.is_tied
    starts = free.sample_starts(np.random.default_rng(0), 50)
    rocker = starts[:, 2]
    assert np.ptp(rocker) > 5  # all the way round
    states, is_closed = free.closed(starts)
    assert states is starts
    assert is_closed.all()


def test_the_other_joints_follow_a_start():
    system = system_of(FOUR_BAR)
    start = system.start_at(["crank=0.7", "crank.velocity=2"])
    assert start[0] == 0.7
    assert start[3] == 2.0
    assert_closed(system, start[None])
    typed = [f"{name}={start[entry]:.3f}" for entry, name in enumerate(("crank", "rod", "rocker"))]
    again = system.start_at(typed)
    np.testing.assert_allclose(again[:3], start[:3], atol=5e-3)
    assert_closed(system, again[None])


def test_a_start_that_cannot_be_is_refused_with_one_that_can():
    system = system_of(FOUR_BAR)
    with pytest.raises(
        NeuroAnimatorError, match=r"'loop' \(connect\) stays .* m open.*Leave out.*possible is"
    ):
        system.start_at(["crank=0.7", "rod=1", "rocker=-1"])


@pytest.mark.parametrize(
    ("equality", "named"),
    [
        ('<connect name="far" site1="there" site2="tip"/>', r"'far' \(connect\) stays 1\.\d+ m"),
        ('<joint joint1="a" polycoef="2 0 0 0 0"/>', r"'equality_0' \(joint\) stays 0\.5 m or rad"),
    ],
)
def test_a_model_that_cannot_be_closed_is_refused_by_the_name_of_its_equality(equality, named):
    inside = (
        '<worldbody><site name="there" pos="2 0 0"/><body><joint name="a" range="-1 1" limited="true"/>'
        f'<geom size="0.1"/><site name="tip" pos="0.3 0 0"/></body></worldbody><equality>{equality}</equality>'
    )
    with pytest.raises(NeuroAnimatorError, match=named):
        system_of(inside)


def test_states_scattered_about_a_motion_satisfy_the_equalities():
    system = system_of(FOUR_BAR)
    controls = np.full((1, 60, 1), 0.1)
    motion = system.simulate(system.rest[None], controls, 0.02).states[0]
    rng = np.random.default_rng(0)
    starts, _ = runs_near(system, motion, controls[0], np.arange(60), 4, 0.1, rng)
    assert_closed(system, starts)


def test_bodies_of_a_family_are_closed_with_their_own_parameters():
    system = system_of(FOUR_BAR)
    definition = Definition.model_validate(
        {
            "name": "m",
            "model": "m.xml",
            "physics": {"step": 0.002, "truth_step": 0.002, "fine_step": 0.0002},
            "parameters": {"reach": {"sets": "body/rocker/pos[0]", "range": [0.3, 0.4]}},
            "sampling": {"position": {"crank": 1.0, "rod": 1.0, "rocker": 1.0}},
        }
    )
    family = ModelSystem(definition, system.model)
    starts = family.sample_starts(np.random.default_rng(0), 50)
    assert starts[:, -1].std() > 0.01
    for state in [*starts, family.at(reach=0.31).rest, family.start_at({"reach": 0.39})]:
        model = family.model_of(state)
        data = mujoco.MjData(model)
        family.put(data, state)
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[: data.ne]).max() < GAP


def test_sensors_of_a_closed_start_are_read_there():
    sensor = '<sensor><framepos name="place" objtype="body" objname="rod"/></sensor>'
    plain = system_of(FOUR_BAR + sensor)
    definition = Definition.model_validate(
        {
            "name": "m",
            "model": "m.xml",
            "sensors": ["place"],
            "physics": {"step": 0.002, "truth_step": 0.002, "fine_step": 0.0002},
            "sampling": {"position": {"crank": 3.0}},
        }
    )
    system = ModelSystem(definition, plain.model)
    data = mujoco.MjData(system.model)
    for state in system.sample_starts(np.random.default_rng(0), 10):
        system.put(data, state)
        mujoco.mj_forward(system.model, data)
        np.testing.assert_allclose(state[6:9], data.sensordata, atol=1e-12)
