"""MyEnvironment beside its original, part by part as in PORTING.md; each test tells what differs first."""

from pearl_marl.porting import Port

from my_environment.original import original, pose, read
from my_environment.step import State, @imported_view@initial, observe

PORT = Port(
    original(),
    State,
    initial,
    observe,
    read,
    pose,
@port_more@)


def test_1_the_state_holds_what_the_original_has() -> None:
    assert PORT.wrong_state() is None


def test_1_the_original_can_be_posed() -> None:
    """Put into a state, it goes on as the one that the state was read of."""
    assert PORT.wrong_pose() is None


def test_2_episodes_begin_as_the_originals() -> None:
    assert PORT.wrong_start() is None


def test_3_observations_are_the_originals() -> None:
    assert PORT.wrong_observation() is None


def test_4_steps_are_the_originals() -> None:
    """Next state, reward and end, from states that the original comes to by random actions."""
    from my_environment.spec import SPEC  # which takes all parts

    assert PORT.wrong_step(SPEC) is None
