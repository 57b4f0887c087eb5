"""PyVerilator is the package that its model is made for."""

from __future__ import annotations

import importlib.metadata
import sys

import pytest

from pearl_marl.devices.simulator import pyverilator_model
from pearl_marl.errors import DeviceError


def test_it_is_for_the_installed_version() -> None:
    """A newer one may need other code around it, or none: look through pyverilator_model.py."""
    assert importlib.metadata.version("pyverilator") == pyverilator_model.VERSION


def test_the_package_is_left_as_it_is() -> None:
    pyverilator_model.package()
    pyverilator_model.model_class()
    assert "tclwrapper" not in sys.modules
    with pytest.raises(NotImplementedError):
        pyverilator_model.package().verilator_name_to_standard_modular_name("a__BRA__0__KET__")


@pytest.mark.parametrize("traced", [True, False])
def test_code_around_a_model(traced: bool) -> None:
    header = "VL_IN8(&clk_i,0,0);\nVL_INW(&wdata_i,127,0,4);\nVL_OUT64(&rdata_o,63,0);\n"
    in_core = "pearl_top__DOT__u_pe__DOT__u_core__DOT__sum_1"
    root = (
        "        CData/*0:0*/ pearl_top__DOT__busy;\n        CData/*0:0*/ __VstlContinue;\n"
        f"        IData/*16:0*/ {in_core};\n"
    )
    text = pyverilator_model.wrapper_code(header, root, "// ours", traced)
    assert '"clk_i","wdata_i"' in text
    assert "{1,128}" in text
    assert "top->rootp->pearl_top__DOT__busy" in text
    assert "new Vpearl_top(context)" in text
    assert ("start_vcd_trace" in text) == traced
    assert (in_core in text) == traced
    assert text.endswith("// ours")


def test_another_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pyverilator_model.package.cache_clear()
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.8.0")
    with pytest.raises(DeviceError, match=r"PyVerilator 0.7.0 .* is 0.8.0; install it with"):
        pyverilator_model.package()


def test_names_of_signals() -> None:
    assert pyverilator_model.signal_path("clk_i") == "clk_i"
    name = "pearl_top__DOT__u_backbone__DOT__gen_pe__BRA__3__KET____DOT__u_pe__DOT__a__024b"
    assert pyverilator_model.signal_path(name) == "u_backbone.gen_pe[3].u_pe.a$b"
