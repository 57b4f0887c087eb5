"""The memory map as a property: whatever the sizes, its regions lie side by side and hold their slots."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pearl_marl
from pearl_marl.errors import ArgumentError
from pearl_marl.memory_map import (
    DATA_WIDTHS,
    Control,
    Doorbell,
    MemoryMap,
    Status,
    default_map,
    memory_map,
)
from pearl_marl.spec import word_bits

from .toy import DRIFT, LADDER
from .toy_fields import RELAY, ROVER

SPECS = [pearl_marl.get_spec(name) for name in pearl_marl.list_envs()] + [DRIFT, LADDER, ROVER, RELAY]


@st.composite
def maps(draw: st.DrawFn) -> tuple[pearl_marl.EnvSpec, MemoryMap]:
    spec = draw(st.sampled_from(SPECS))
    n_envs = draw(st.one_of(st.integers(1, 200), st.integers(1, 1 << 20)))
    return spec, memory_map(spec, n_envs, draw(st.integers(1, n_envs)), draw(st.sampled_from(DATA_WIDTHS)))


@settings(max_examples=200)
@given(maps())
def test_regions(case: tuple[pearl_marl.EnvSpec, MemoryMap]) -> None:
    spec, layout = case
    word = layout.data_wl // 8
    address = 0
    for region in layout.regions:
        assert region.offset == address, f"{region.name} leaves a gap or overlaps"
        assert region.offset % word == 0
        assert layout[region.name] is region
        assert layout.size(region.name) == region.words * word
        assert layout.end(region.name) == region.offset + layout.size(region.name)
        if region.slot_bits:
            assert region.rows * region.row_slots >= layout.n_envs
            words = -(-region.row_slots * region.slot_bits // layout.data_wl)
            if region.rows == 1 and region.row_slots == layout.n_envs:
                assert region.row_words in (words, 1 << (words - 1).bit_length())
            else:
                assert (region.rows, region.row_slots) == (layout.groups, layout.pe_num)
                assert region.row_words == 1 << (words - 1).bit_length(), "groups start at a power of two"
            if region.name in ("reset_mask", "actions", "observations", "rewards", "ters"):
                assert (region.rows, region.row_words) == (1, words), "no more than a word is padding"
        address = layout.end(region.name)
    widths = {
        "initial_states": word_bits(spec.state),
        "actions": spec.agents * word_bits(spec.action_fields),
        "observations": spec.agents * (word_bits(spec.observation) + len(spec.mask_fields)),
        "rewards": spec.agents * spec.reward.bits,
        "ters": spec.agents + 1,
        "reset_mask": 1,
    }
    assert {name: layout[name].slot_bits for name in widths} == widths
    for name, registers in (("control", Control), ("doorbell", Doorbell), ("status", Status)):
        assert 8 * layout.size(name) >= 32 * len(registers)
    assert layout.groups * layout.pe_num >= layout.n_envs > (layout.groups - 1) * layout.pe_num


@settings(max_examples=100)
@given(maps())
def test_a_step_is_one_transfer_each_way(case: tuple[pearl_marl.EnvSpec, MemoryMap]) -> None:
    _, layout = case
    for (start, length), wanted in (
        (layout.step_write, {"actions", "doorbell"}),
        (layout.step_read, {"observations", "rewards", "ters", "status"}),
    ):
        inside = {
            r.name for r in layout.regions if start <= r.offset and layout.end(r.name) <= start + length
        }
        assert inside == wanted
        assert sum(layout.size(name) for name in inside) == length, "nothing else is transferred"
    # The doorbell starts the step and the status ends it, so they are the last words of their transfer.
    start, length = layout.step_write
    assert layout.end("doorbell") == start + length
    start, length = layout.step_read
    assert layout.end("status") == start + length


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((0, 1, 32), "n_envs is 0"),
        ((-5, 1, 32), "n_envs is -5"),
        ((1 << 32, 1, 32), "n_envs is 4,294,967,296; hardware tells it in 32 bits"),
        ((8, 0, 32), "pe_num is 0.*1 to n_envs = 8"),
        ((8, 9, 32), "pe_num is 9.*1 to n_envs = 8"),
        ((8, 4, 48), "data_wl is 48.*32, 64, 128"),
        ((8, 4, 16), "data_wl is 16"),
    ],
)
def test_refusals(arguments: tuple[int, int, int], complaint: str) -> None:
    with pytest.raises(ArgumentError, match=complaint):
        memory_map(SPECS[0], *arguments)


@settings(max_examples=200)
@given(st.sampled_from(SPECS), st.one_of(st.integers(1, 200), st.integers(1, 1 << 20)))
def test_default_sizes(spec: pearl_marl.EnvSpec, n_envs: int) -> None:
    """As the page on hardware has the rule: a power of two, and twice of it would break a limit."""
    layout = default_map(spec, n_envs)
    draws = spec.reset_draws + spec.step_draws
    seen = word_bits(spec.observation) + len(spec.mask_fields)
    widest = max(
        *(spec.agents * bits for bits in (word_bits(spec.action_fields), seen, spec.reward.bits)),
        spec.agents + 1,
    )

    def allowed(pe_num: int) -> bool:
        return pe_num <= 128 and pe_num * draws <= 128 and pe_num * widest <= 1024

    assert layout.pe_num.bit_count() == 1
    assert allowed(layout.pe_num) or layout.pe_num == 1
    assert layout.groups <= 16 or not allowed(2 * layout.pe_num)
    assert layout.pe_num == 1 or -(-2 * n_envs // layout.pe_num) > 16, "half as many would do"
    assert layout.data_wl == min(
        width for width in DATA_WIDTHS if width >= layout.pe_num * widest or width == 1024
    )
    assert default_map(spec, n_envs, 1).pe_num == 1
    assert default_map(spec, n_envs, data_wl=64).data_wl == 64


def test_default_sizes_that_the_page_shows() -> None:
    page = (Path(__file__).parents[1] / "docs" / "environment_figures.md").read_text()
    lines = page.partition("## In hardware")[2].splitlines()[4:]
    rows = [line[2:-2].replace(",", "").split(" | ") for line in lines]
    shown = {name: [int(cells[column - 1]) for column in (1, 10, 11, 12, 13)] for name, *cells in rows}
    assert list(shown) == pearl_marl.list_envs()
    for name, (latency, pe_num, data_wl, bound, cycles) in shown.items():
        layout = default_map(pearl_marl.get_spec(name), 43_008)
        assert (layout.pe_num, layout.data_wl) == (pe_num, data_wl)
        words = (layout[region].words for region in ("actions", "observations", "rewards", "ters"))
        assert max(layout.groups, *words) == bound
        assert bound + latency < cycles <= 1.1 * (bound + latency)
