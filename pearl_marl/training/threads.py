"""How many threads PyTorch learns with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

from pearl_marl.spec import EnvSpec

WORTH = 1 << 17
"""Elements of a layer's output from which on a second thread pays, pictures apart."""


@contextmanager
def threads_for(spec: EnvSpec, settings: Any) -> Iterator[None]:
    """Learn in the block with one thread where networks and minibatches are small, else with all there are.

    It depends on nothing but the settings: another number of threads adds numbers up in another order.
    """
    before = torch.get_num_threads()
    picture = len(spec.observation_space.shape or ()) == 3
    elements = getattr(settings, "minibatch", 0) * getattr(settings, "width", 0)
    torch.set_num_threads(before if picture or elements >= WORTH else 1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
