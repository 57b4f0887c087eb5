"""Copies of devices: each is a device of its own, which shares nothing that is open with the first one."""

from __future__ import annotations

from typing import Any


def unopened(setting: Any) -> Any:
    """Return a setting of a device as it was when that was made: other devices in it without a batch."""
    if isinstance(setting, list):
        return [unopened(value) for value in setting]
    if not hasattr(setting, "made_with"):  # no device, or one that is not open
        return setting
    fresh = object.__new__(type(setting))
    fresh.__dict__.update({name: unopened(value) for name, value in setting.made_with.items()})
    return fresh
