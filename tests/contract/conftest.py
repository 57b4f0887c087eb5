"""What is about no device is tested once."""

from __future__ import annotations

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out tests in which devices have no part where the class is about others than the CPU."""
    chosen, others = [], []
    for item in items:
        devices = getattr(getattr(item, "cls", None), "devices", ("native",))
        is_wanted = "native" in devices or "device_name" in getattr(item, "fixturenames", ())
        (chosen if is_wanted else others).append(item)
    config.hook.pytest_deselected(items=others)
    items[:] = chosen
