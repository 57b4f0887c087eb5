"""Planes go through filters as PyTorch's convolution has them, and gradients are those of autograd."""

from __future__ import annotations

import os
import signal
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from torch import Tensor, nn

from pearl_marl.errors import ArgumentError
from pearl_marl.policies.convolution import BLOCK, SHARED, SIDE, PlanesLayer, are_planes
from pearl_marl.policies.convolution_vectors import FILTERS, PANEL
from pearl_marl.policies.network import Encoder

WIDTH = 5
apply: Any = PlanesLayer.apply


class Layers(nn.Module):
    """Both layers by PyTorch."""

    def __init__(self, rows: int, columns: int, channels: int, width: int = WIDTH) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(channels, FILTERS, SIDE)
        self.linear = nn.Linear(FILTERS * (rows - 2) * (columns - 2), width)

    def forward(self, planes: Tensor) -> Tensor:
        made = self.convolution(planes.permute(0, 3, 1, 2).float()).relu()
        outputs: Tensor = self.linear(made.permute(0, 2, 3, 1).flatten(1))
        return outputs


def planes(n: int, shape: tuple[int, ...], dtype: torch.dtype = torch.uint8, share: float = 0.2) -> Tensor:
    random = torch.Generator().manual_seed(n)
    return (torch.rand((n, *shape), generator=random) < share).to(dtype)


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.int8])
@pytest.mark.parametrize("shape", [(10, 10, 10), (7, 7, 3), (5, 5, 2), (3, 4, 1), (3, 3, 7)])
@pytest.mark.parametrize("n", [0, 1, SHARED, BLOCK, BLOCK + 3])
@pytest.mark.parametrize("share", [0.02, 0.2, 1.0])
def test_outputs_and_gradients_are_pytorchs(
    n: int, shape: tuple[int, ...], dtype: torch.dtype, share: float
) -> None:
    compare(Layers(*shape), planes(n, shape, dtype, share))


@pytest.mark.parametrize("width", [1, PANEL, PANEL + 6, 2 * PANEL])
@pytest.mark.parametrize("channels", [21, 22, 50])
def test_any_width_and_number_of_planes(width: int, channels: int) -> None:
    """64 elements of a square's row are read at a time, and a panel of outputs is summed."""
    shape = 5, 6, channels
    compare(Layers(*shape, width), planes(40, shape, share=0.03))


def compare(layers: Layers, obs: Tensor) -> None:
    """Compare outputs and gradients, from weights of which about half of the filters' biases are above 0."""
    torch.manual_seed(0)
    n, parameters = len(obs), list(layers.parameters())
    scores = torch.randn(n, layers.linear.out_features)
    found = []
    for outputs in (layers(obs), apply(obs, *parameters)):
        found.append((outputs, *torch.autograd.grad((outputs * scores).sum(), parameters)))
    for expected, ours in zip(*found, strict=True):
        torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-4 * max(n, 1) ** 0.5)


def test_squares_are_told_apart_and_equal_ones_are_found() -> None:
    """Of all squares with at most two elements, each in two pictures that are not next to each other."""
    layers = Layers(3, 3, 3)
    single = torch.eye(27, dtype=torch.uint8)
    pairs = [single[i] | single[j] for i in range(27) for j in range(i + 1)]
    obs = torch.stack([torch.zeros_like(pairs[0]), *pairs]).repeat(2, 1).view(-1, 3, 3, 3)
    compare(layers, obs)
    outputs = apply(obs, *layers.parameters())
    first, again = outputs.view(2, -1, WIDTH)
    assert torch.equal(first, again)
    assert len(torch.unique(first, dim=0)) == len(first)


@pytest.mark.parametrize("n", [SHARED - 1, SHARED + 1, 2 * BLOCK + 1])
def test_threads_change_nothing(n: int) -> None:
    """Whether they divide pictures, or these pictures' lines."""
    layers, obs = Layers(6, 5, 4), planes(n, (6, 5, 4))
    found, threads = [], torch.get_num_threads()
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            outputs = apply(obs, *layers.parameters())
            found.append((outputs, *torch.autograd.grad(outputs.square().sum(), list(layers.parameters()))))
    finally:
        torch.set_num_threads(threads)
    for one, two in zip(*found, strict=True):
        assert torch.equal(one, two)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks are of POSIX")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_starts_a_thread_of_its_own() -> None:
    """The one of the process that it comes from is not there, and would never be done."""
    layers, obs, threads = Layers(6, 5, 4), planes(2 * BLOCK, (6, 5, 4)), torch.get_num_threads()
    arguments = [obs, *(parameter.detach() for parameter in layers.parameters())]
    torch.set_num_threads(2)
    try:
        apply(*arguments)
        child = os.fork()
        if child == 0:
            signal.alarm(20)  # ends a process that waits
            apply(*arguments)
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
    finally:
        torch.set_num_threads(threads)


def test_planes_need_not_lie_in_a_row() -> None:
    layers, wide = Layers(6, 5, 4), planes(9, (6, 10, 4))
    torch.testing.assert_close(apply(wide[:, :, ::2], *layers.parameters()), layers(wide[:, :, ::2]))


def test_biases_need_not_either() -> None:
    layers, obs = Layers(6, 5, 4), planes(9, (6, 5, 4))
    weights, _, *others = layers.parameters()
    for bias in (torch.randn(1).expand(FILTERS), torch.randn(FILTERS, 2)[:, 1]):
        layers.convolution.bias = nn.Parameter(bias.clone())
        torch.testing.assert_close(apply(obs, weights, bias, *others), layers(obs))


def test_gradients_can_be_asked_for_twice() -> None:
    layers, obs = Layers(6, 5, 4), planes(9, (6, 5, 4))
    outputs = apply(obs, *layers.parameters()).sum()
    first, again = (torch.autograd.grad(outputs, layers.parameters(), retain_graph=True) for _ in range(2))
    assert all(torch.equal(one, two) for one, two in zip(first, again, strict=True))


def test_what_was_changed_since_is_noticed() -> None:
    layers, obs = Layers(6, 5, 4), planes(9, (6, 5, 4))
    outputs = apply(obs, *layers.parameters()).sum()
    obs.zero_()
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        outputs.backward()


def test_what_is_no_number_is_seen() -> None:
    """A training that diverges is stopped where losses are not finite."""
    layers, obs = Layers(6, 5, 4), planes(9, (6, 5, 4))
    with torch.no_grad():
        layers.convolution.weight.fill_(torch.nan)
    assert apply(obs, *layers.parameters()).isnan().all()


@pytest.mark.parametrize(
    ("high", "dtype", "shape", "whether"),
    [
        (1, np.uint8, (7, 7, 3), True),
        (1, np.int8, (7, 7, 3), True),
        (True, np.bool_, (7, 7, 3), True),
        (2, np.uint8, (7, 7, 3), False),
        (1, np.float32, (7, 7, 3), False),
        (1, np.uint8, (7, 7), False),
    ],
)
def test_only_planes_of_0_and_1_go_this_way(high: Any, dtype: Any, shape: Any, whether: bool) -> None:
    space = Box(np.zeros(shape, dtype), np.full(shape, high, dtype), dtype=dtype)
    assert are_planes(space) is whether
    if len(shape) == 3:
        encoder = Encoder(space, WIDTH)
        obs = torch.from_numpy(np.full((4, *shape), high, dtype))
        torch.testing.assert_close(encoder(obs), encoder(obs.float()))


@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 5, 3), (5, 2, 3)])
def test_pictures_are_as_large_as_filters(shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError, match=f"pictures of {shape[0]} by {shape[1]} are too small"):
        Encoder(Box(0, 1, shape, np.uint8), WIDTH)
