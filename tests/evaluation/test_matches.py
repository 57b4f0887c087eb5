"""Policies against each other, and what an evaluation tells of teams."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.devices import BatchConfig, Native
from pearl_marl.errors import ArgumentError
from pearl_marl.evaluation import Evaluation, Match, cross_table
from pearl_marl.policies.loading import load_policy

from ..toy_world import MEADOW, NIM

Pearl = Callable[..., tuple[int, str, str]]
N = 400


def perfect(heaps: Any, masks: Any) -> Any:
    """Nim: leave a multiple of four, if there is a way."""
    return np.where(masks.any(1), np.maximum(heaps % 4, 1) - 1, 0)


def greedy(heaps: Any, masks: Any) -> Any:
    """Take as much as possible."""
    return np.maximum(masks.sum(1) - 1, 0)


def done(match: Match) -> dict[str, Any]:
    for _ in match.run():
        pass
    return match.outcome()


def won_by(first: Any, second: Any, seed: int = 0) -> list[bool]:
    """Play every game of Nim by hand, from the device's starts; return who of them the first policy won."""
    device = Native().open(BatchConfig(spec=NIM, n_envs=N // 2))
    device.reset(seed)
    results = []
    for world, (heap, turn) in enumerate(device.state().astype(int)):
        players = [first, second] if world % 2 == 0 else [second, first]
        while heap:
            mask = np.array([[heap > k for k in range(3)]])
            heap -= int(players[turn](np.array([heap]), mask)[0]) + 1
            turn ^= 1
        results.append(turn ^ 1 == world % 2)
    device.close()
    return results


@pytest.mark.parametrize(("first", "second"), [(perfect, greedy), (greedy, perfect), (perfect, perfect)])
def test_games_go_as_they_go_by_hand(first: Any, second: Any) -> None:
    outcome = done(Match(NIM, first, second, N, openings=0))
    wins = sum(won_by(first, second))
    assert (outcome["games"], outcome["wins"], outcome["draws"]) == (N // 2, wins, 0)
    assert outcome["losses"] == N // 2 - wins
    assert outcome["return"]["mean"] == pytest.approx((2 * wins - N // 2) / (N // 2))
    assert outcome["their_return"]["mean"] == pytest.approx(-outcome["return"]["mean"])


def test_a_perfect_player_wins_more() -> None:
    assert done(Match(NIM, perfect, greedy, N, openings=0))["wins"] > 0.7 * N / 2


def test_seats_take_turns() -> None:
    seats = Match(MEADOW, perfect, greedy, 40).seats.reshape(10, 4)
    assert (seats.sum(1) == 1).all()
    assert seats.argmax(1).tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]


@pytest.mark.parametrize("openings", [0, 1, 3])
def test_games_begin_with_random_moves(openings: int) -> None:
    """Two who always take one counter: in each game, the first moves alone are others."""
    seen: list[tuple[Any, Any]] = []

    def one(heaps: Any, masks: Any) -> Any:
        seen.append((heaps.copy(), masks.any(1)))
        return np.zeros(len(heaps), np.int64)

    match = Match(NIM, one, one, N, openings=openings)
    done(match)
    heaps = [heaps[::2].astype(int) for heaps, _ in seen]
    elapsed = np.zeros(N // 2, int)
    others = np.zeros(20, int)
    for before, after in itertools.pairwise(heaps):
        over = after >= before  # a new game, as an empty heap is not seen
        taken = before - after
        for t in range(20):
            others[t] += ((taken != 1) & ~over & (elapsed == t)).sum()
        elapsed = np.where(over | (before == 1), 0, elapsed + 1)
    assert (others[:openings] > 20).all()
    assert not others[openings:].any()


def test_everybody_meets_everybody() -> None:
    policies = {"perfect": perfect, "greedy": greedy, "random": load_policy("random", NIM)}
    rows = list(cross_table(NIM, policies, N, openings=0))
    assert [(row["policy"], row["against"]) for row in rows] == [
        ("perfect", "greedy"),
        ("perfect", "random"),
        ("greedy", "random"),
    ]
    assert rows[0]["wins"] == sum(won_by(perfect, greedy))


def test_who_is_alone_has_nobody_to_play_against() -> None:
    with pytest.raises(ArgumentError, match="CartPole has one agent in a world"):
        Match(get_spec("CartPole"), perfect, greedy, 4)
    with pytest.raises(ArgumentError, match="openings is -1"):
        Match(NIM, perfect, greedy, 4, openings=-1)


@pytest.mark.parametrize("episodes", [80, 100, 83, 41])
def test_returns_of_worlds(episodes: int) -> None:
    """Sums of what each agent got, of the episodes that count for all of them."""
    evaluation = Evaluation(MEADOW, load_policy("random", MEADOW, 1), 40, episodes=episodes, seed=2)
    for _ in evaluation.run():
        pass
    more = Evaluation(MEADOW, load_policy("random", MEADOW, 1), 40, episodes=120, seed=2)
    for _ in more.run():
        pass
    each = more.returns.reshape(10, 4, 3)  # world, agent, episode
    counts = [min(episodes // 40 + (4 * world + k < episodes % 40) for k in range(4)) for world in range(10)]
    expected = np.concatenate([each[world, :, :count].T for world, count in enumerate(counts)])
    np.testing.assert_array_equal(evaluation.world_returns, expected)
    summary = evaluation.summary()
    assert summary["world_return"]["mean"] == pytest.approx(expected.sum(1).mean())
    assert [row["role"] for row in summary["agents"]] == ["hare", "hare", "snail", "snail"]
    assert [row["mean"] for row in summary["agents"]] == pytest.approx(expected.mean(0))


def test_who_is_alone_is_no_team() -> None:
    evaluation = Evaluation(get_spec("Blackjack"), load_policy("random", get_spec("Blackjack")), 4)
    for _ in evaluation.run():
        pass
    assert "world_return" not in evaluation.summary()


def column(k: int) -> str:
    return (
        f"def column_{k}(obs, masks):\n"
        f"    return [{k} if mask[{k}] else int(mask.argmax()) for mask in masks]\n"
    )


@pytest.fixture
def players(tmp_path: Path) -> Path:
    path = tmp_path / "players.py"
    path.write_text("\n".join(map(column, range(7))))
    return path


def test_the_command_tells_who_won(players: Path, pearl: Pearl) -> None:
    given = ("match", "ConnectFour", f"{players}:column_3")
    some = ("--n-agents", 40)
    status, out, err = pearl(*given, f"{players}:column_0", *some, "--openings", 0, "--json")
    assert status == 0, err
    (row,) = json.loads(out)["matches"]
    # Both pile up four discs in their own column, and the one that begins is there first.
    assert row["wins"] == row["losses"] == 10
    assert (row["policy"], row["against"]) == (f"{players}:column_3", f"{players}:column_0")
    assert row["return"]["mean"] == row["their_return"]["mean"] == 0
    assert len(row["digest"]) == 64
    status, out, err = pearl(*given, "random", *some, "--markdown")
    assert status == 0, err
    heading, _, cells, *_ = out.splitlines()
    assert heading == "| policy | against | games | won | drawn | lost | return | its return |"
    assert cells.startswith(f"| {players}:column_3 | random | 20 | ")


def test_a_match_in_lockstep(pearl: Pearl) -> None:
    given = ("match", "ConnectFour", "random", "random", "--n-agents", 4, "--lockstep")
    status, out, err = pearl(*given)
    assert status == 0, err
    assert "native is bit-exact with reference" in out
    status, _, err = pearl(*given, "--device", "reference")
    assert status == 2
    assert "which always agrees with itself" in err


def test_the_old_form_of_a_match(pearl: Pearl) -> None:
    status, out, err = pearl("eval", "ConnectFour", "--policy", "random", "--against", "random", "--json")
    assert status == 0, err
    assert "use `pearl match ConnectFour random random`" in err
    assert json.loads(out)["matches"][0]["policy"] == "random (1)"


def test_the_command_makes_a_cross_table(players: Path, pearl: Pearl, tmp_path: Path) -> None:
    policies = (f"{players}:column_3", f"{players}:column_0", "random")
    given = ("ConnectFour", *policies, "--n-agents", 100)
    status, out, err = pearl("match", *given, "--json", "--out", tmp_path / "out")
    assert status == 0, err
    result = json.loads(out)
    assert len(result["matches"]) == 3
    assert all(row["games"] == 50 for row in result["matches"])
    assert json.loads((tmp_path / "out" / "matches.json").read_text()) == result
    status, out, err = pearl("match", *given)
    assert status == 0, err
    row = result["matches"][0]
    assert f"{row['wins'] / 50:.1%}" in out
    assert f"{row['losses'] / 50:.1%}" in out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("match ConnectFour random", "a match needs two policies: name another one"),
        ("match ConnectFour random {0} --openings 42", "openings is 42, and no game went on for more than"),
        ("match CartPole random {0}", "CartPole has one agent in a world"),
        ("eval ConnectFour --policy random --openings 2", "--openings is an option of pearl match"),
        ("eval ConnectFour --policy random --against {0} --episodes 9", "leave --episodes out"),
    ],
)
def test_what_cannot_be_asked(line: str, words: str, players: Path, pearl: Pearl) -> None:
    status, _, err = pearl(*line.format(f"{players}:column_0").split(), "--n-agents", 8)
    assert status == 2
    assert words in err
