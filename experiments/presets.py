"""Settings that suit an environment better than an algorithm's defaults; found by trial, on one machine."""

from __future__ import annotations

from typing import Any

PRESETS: dict[tuple[str, str], dict[str, Any]] = {}
