"""PyVerilator is the package that the mends are for."""

from __future__ import annotations

import importlib.metadata

import pytest

from pearl_marl.devices.simulator import pyverilator_mends as mends
from pearl_marl.errors import DeviceError


def test_the_mends_are_for_the_installed_version() -> None:
    """A newer one may need other mends, or none: look through pyverilator_mends.py."""
    assert importlib.metadata.version("pyverilator") == mends.VERSION


def test_what_is_mended_is_still_there() -> None:
    module = mends.package()
    text = module.template_cpp.template_cpp(
        "top", [("a", 1)], [("b", 70)], [("pearl_top__DOT__c", 3)], "null"
    )
    assert text.count(mends._CONSTRUCT.format(top="top")) == 1
    assert len(mends._TRACE_FUNCTIONS.findall(text)) == 1
    assert "top->pearl_top__DOT__c" in text
    for name in ("call_process", "shutil", "verilator_name_to_standard_modular_name", "PyVerilator"):
        assert hasattr(module, name)


def test_another_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    mends.package.cache_clear()
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.8.0")
    with pytest.raises(DeviceError, match=r"PyVerilator 0.7.0 .* is 0.8.0; install it with"):
        mends.package()


def test_names_of_signals() -> None:
    assert mends._path("clk_i") == ("clk_i",)
    name = "pearl_top__DOT__u_backbone__DOT__gen_pe__BRA__3__KET____DOT__u_pe__DOT__a__024b"
    assert mends._path(name) == ("u_backbone", "gen_pe[3]", "u_pe", "a$b")
