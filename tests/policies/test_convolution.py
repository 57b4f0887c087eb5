"""Pictures go through filters as PyTorch's convolution has them, and gradients are those of autograd."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from pearl_marl.policies.convolution import BLOCK, FILTERS, SIDE, PictureLayer

WIDTH = 5


class Layers(nn.Module):
    """Both layers by PyTorch."""

    def __init__(self, rows: int, columns: int, channels: int) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(channels, FILTERS, SIDE)
        self.linear = nn.Linear(FILTERS * (rows - 2) * (columns - 2), WIDTH)

    def forward(self, pictures: Tensor) -> Tensor:
        planes = pictures.permute(0, 3, 1, 2).float()
        made: Tensor = self.linear(self.convolution(planes).relu().permute(0, 2, 3, 1).flatten(1))
        return made


def pictures(shape: tuple[int, ...], dtype: torch.dtype, random: torch.Generator) -> Tensor:
    """Return pictures whose elements are 0 in four places of five."""
    numbers = torch.randint(1, 100, shape, generator=random) * (torch.rand(shape, generator=random) < 0.2)
    if dtype.is_floating_point:
        return numbers.to(dtype) / 100 - (numbers > 50).to(dtype)
    return numbers.to(dtype)


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.int64, torch.float32])
@pytest.mark.parametrize("shape", [(10, 10, 10), (7, 7, 3), (5, 5, 2), (3, 4, 1), (3, 3, 7)])
@pytest.mark.parametrize("n", [0, 1, BLOCK, BLOCK + 3])
def test_outputs_and_gradients_are_pytorchs(n: int, shape: tuple[int, ...], dtype: torch.dtype) -> None:
    random = torch.Generator().manual_seed(n)
    torch.manual_seed(0)
    layers = Layers(*shape)
    obs, scores = pictures((n, *shape), dtype, random), torch.randn((n, WIDTH), generator=random)
    parameters = list(layers.parameters())
    apply: Any = PictureLayer.apply
    found = []
    for outputs in (layers(obs), apply(obs, *parameters)):
        found.append((outputs, *torch.autograd.grad((outputs * scores).sum(), parameters)))
    for expected, ours in zip(*found, strict=True):
        torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-3 if n else 0)


def test_pictures_need_not_lie_in_a_row() -> None:
    layers, apply = Layers(6, 5, 4), PictureLayer.apply
    wide = torch.randint(0, 2, (9, 6, 10, 4), dtype=torch.uint8)
    some: Any = apply(wide[:, :, ::2], *layers.parameters())
    torch.testing.assert_close(some, layers(wide[:, :, ::2]))
