"""The table of environments, and the widths that the paper gives."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from pearl_marl import get_spec, list_envs
from pearl_marl.benchmark.paper import TABLE_2
from pearl_marl.cli.envs import markdown
from pearl_marl.experiments import environment_figures
from pearl_marl.spec import snake_case, word_bits

from .. import sampling
from ..sampling import KINDS
from ..toy import DRIFT, LADDER, SLIDE

ROOT = Path(__file__).parents[2]
MARKER = "to the last line. -->\n\n"
"""Where a page begins that ``make tables`` writes."""
PAGES = "environments.md", "environment_figures.md"
TEXTS = "", ".cpp", ".ipynb", ".md", ".py", ".sv", ".toml", ".txt", ".yml"


def test_the_page_is_that_of_the_registry() -> None:
    before, marker, text = (ROOT / "docs" / "environments.md").read_text().partition(MARKER)
    assert before
    assert marker
    assert text == markdown([get_spec(name) for name in list_envs()]), "make tables"


def test_the_figures_are_those_of_the_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for most designs, which take seconds: `make test-exhaustive` computes all of them."""
    before, marker, text = (ROOT / "docs" / "environment_figures.md").read_text().partition(MARKER)
    assert before
    assert marker
    rows = [line[2:-2].split(" | ") for line in text.partition("## In hardware")[2].splitlines()[4:]]
    designs = {
        row[0]: (row[1], *row[10:15]) for row in rows if row[0] not in KINDS and not sampling.exhaustive
    }
    computed = environment_figures.design
    monkeypatch.setattr(environment_figures, "design", lambda spec: designs.get(spec.name) or computed(spec))
    expected = f"{environment_figures.software()}\n\n{environment_figures.hardware()}\n"
    assert text == expected, "make tables"


@pytest.mark.parametrize("name", ["MiniGridKeyCorridor", "MiniGridLavaGap", "MiniGridMemory", "Pursuit"])
def test_an_environment_touches_its_folder_and_its_test(name: str) -> None:
    """And pages that ``make tables`` writes anew. No example is about these environments."""
    folders = ".ci", "docs", "examples", "experiments", "pearl_marl", "rtl", "tests", "wrappers"
    written = {ROOT / "CHANGELOG.md", *(ROOT / "docs" / page for page in PAGES), Path(__file__)}
    files = [*ROOT.glob("*"), *(file for folder in folders for file in (ROOT / folder).rglob("*"))]
    texts = [file for file in files if file.suffix in TEXTS and file.is_file() and file not in written]
    elsewhere = [file for file in texts if ROOT / "tests" / "envs" not in file.parents]
    assert len(elsewhere) > 600
    named = re.compile(rf"{name}|{snake_case(name)}", re.IGNORECASE)
    assert [file for file in elsewhere if named.search(file.read_text("utf-8", "ignore"))] == []


@pytest.mark.parametrize("name", [name for name in TABLE_2 if name in list_envs()])
def test_no_word_is_wider_than_the_papers(name: str) -> None:
    spec = get_spec(name)
    ours = (
        word_bits(spec.state),
        word_bits(spec.action_fields),
        word_bits(spec.observation),
        spec.reward.bits,
    )
    for word, width, paper in zip(
        ("state", "action", "observation", "reward"), ours, TABLE_2[name].widths, strict=True
    ):
        assert width <= paper, word


def test_rows() -> None:
    """Of a Tuple, of a Box for actions, of an environment without an oracle or options."""
    lines = markdown([DRIFT, LADDER, SLIDE]).splitlines()
    assert lines[3] == (
        "| [**Ladder**](../envs/ladder/README.md)<br>Climb nine rungs | `Tuple(Discrete(10), Discrete(2))`"
        "<br>`Discrete(2)` | none | 4, 1, 5, 4 | none | none |"
    )
    assert "| `Box(3,)`, `float32`<br>`Discrete(5)` | 12 | 70, 3, 27, 16 | `push=20`<br>" in lines[2]
    assert "| `Box(4, 2, 3)`, `bool`<br>`Box(1,)`, `float32` | 9 | 11, 10, 10, 11 |" in lines[4]


def test_what_agents_share(pearl: Callable[..., tuple[int, str, str]]) -> None:
    status, out, _ = pearl("envs")
    assert status == 0
    words = " ".join(out.replace("│", " ").split())
    assert "2 agents a world" in words
    assert "in turns" in words
    rows = {row["name"]: row for row in json.loads(pearl("envs", "--json")[1])}
    assert (rows["ConnectFour"]["agents"], rows["ConnectFour"]["turns"]) == (2, True)
    assert rows["ConnectFour"]["masks"] == "refused"
    assert rows["CartPole"]["follows"] == "Gymnasium CartPole-v1"
    assert rows["LevelBasedForaging"]["follows"] == "lbforaging Foraging-8x8-2p-3f-v3"
    assert all(row["follows"] for row in rows.values()), "each is compared with one"
    assert "follows rware rware-tiny-2ag-v2" in words
    assert (rows["CliffWalking"]["agents"], rows["CliffWalking"]["masks"]) == (1, None)
