"""What every environment must do on every device, as tests that any package can run.

A test module of yours runs all of it with

>>> from pearl_marl.testing import ContractSuite
>>> class TestMyEnvironment(ContractSuite):
...     environments = ("my_package:MyEnvironment",)
...     devices = ("native", "rtl")

This repository's own ``tests/contract`` does the same, for its environments and its devices. The
package needs pytest: ``pip install '.[testing]'``.
"""

import pkgutil

try:
    import pytest
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "pearl_marl.testing needs pytest; install it with: pip install '.[testing]'", name=error.name
    ) from None

# Before the modules are imported: pytest then shows the values in a failed assertion of theirs.
pytest.register_assert_rewrite(*(f"{__name__}.{module.name}" for module in pkgutil.iter_modules(__path__)))

from pearl_marl.porting.oracle import Games, Outcome, Rules, compare, one_by_one  # noqa: E402
from pearl_marl.testing.case import (  # noqa: E402
    HALF,
    SIZE,
    STEPS,
    Case,
    assert_same_step,
    assert_same_trajectory,
    make_device,
    rows,
    trajectory,
)
from pearl_marl.testing.oracles import (  # noqa: E402
    assert_same_play,
    compare_pictures,
    compare_steps,
    every_state,
    first_episodes,
    step_from,
)
from pearl_marl.testing.suite import ContractSuite, DeviceSuite  # noqa: E402

__all__ = [
    "HALF",
    "SIZE",
    "STEPS",
    "Case",
    "ContractSuite",
    "DeviceSuite",
    "Games",
    "Outcome",
    "Rules",
    "assert_same_play",
    "assert_same_step",
    "assert_same_trajectory",
    "compare",
    "compare_pictures",
    "compare_steps",
    "every_state",
    "first_episodes",
    "make_device",
    "one_by_one",
    "rows",
    "step_from",
    "trajectory",
]
