"""Texts with placeholders, which are words of any kind: a name, or a line of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping


def fill(template: str, words: Mapping[str, str]) -> str:
    """Return a template with words replaced, the longer ones first; what replaces one is left as it is."""
    longest_first = sorted(words, key=len, reverse=True)
    return re.sub("|".join(map(re.escape, longest_first)), lambda match: words[match[0]], template)
