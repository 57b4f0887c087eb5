"""How scripts of experiments answer the command line."""

from __future__ import annotations

import sys

import pytest

from pearl_marl.errors import ArgumentError
from pearl_marl.experiments.calling import call


def refused(name: str = "") -> None:
    """Do nothing with a name."""
    raise ArgumentError(f"{name!r}, :b: is not installed: pip install '.[bench]'")


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help(option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["script", option])
    with pytest.raises(SystemExit) as exit_:
        call(refused)
    assert exit_.value.code == 0
    assert "Do nothing with a name." in capsys.readouterr().out


def test_a_sentence_is_printed_as_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["script", "--name", "[red]"])
    with pytest.raises(SystemExit) as exit_:
        call(refused)
    expected = "Error: '[red]', :b: is not installed: pip install '.[bench]'\n"
    assert (exit_.value.code, capsys.readouterr().err) == (2, expected)
