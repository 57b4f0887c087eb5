"""The engine for a policy takes it, and no more than it needs."""

from __future__ import annotations

import numpy as np
import pytest

from pearl_marl import get_spec
from pearl_marl.errors import ArgumentError
from pearl_marl.hardware.build import Build
from pearl_marl.hardware.engines import with_engine
from pearl_marl.hardware.policy_words import policy_words
from pearl_marl.memory_map import Engine
from pearl_marl.policies.golden_policy import GoldenPolicy

from ..policies.rules import balance
from ..rtl.random_policies import random_network, random_planes, random_table


def test_an_engine_takes_the_policy_that_it_is_for() -> None:
    random, cart, cliff = np.random.default_rng(0), get_spec("CartPole"), get_spec("CliffWalking")
    games = get_spec("Breakout")
    for spec, policy, kind in (
        (cart, random_network(random, cart, [16, 12], drawn=True), "network"),
        (cart, random_network(random, cart, [], drawn=False), "network"),
        (games, random_planes(random, games, 6, [9], drawn=True), "planes"),
        (cliff, random_table(random, cliff, 10, drawn=True), "table"),
    ):
        build = with_engine(Build.of(spec, 40, 4), policy)
        engine = build.layout.engine
        assert engine is not None
        assert (engine.kind, engine.drawn) == (kind, policy.draws > 0)
        assert (engine.rounds > 1) == (kind == "network" and len(policy.layers) > 1)
        assert policy_words(policy, engine)
    rule = GoldenPolicy(cart, balance)
    assert with_engine(Build.of(cart, 40, 4), rule).layout.engine == Engine("golden", function=rule)
    plain = Build.of(cart, 40, 4)
    assert with_engine(plain, None) is plain
    with pytest.raises(ArgumentError, match="the policy is for CliffWalking"):
        with_engine(plain, policy)
