"""What the tests share, besides what :mod:`pearl_marl.testing` has for everybody's."""

from __future__ import annotations

import pearl_marl

from .toy import TOYS

ENVIRONMENTS = (*pearl_marl.envs(), *(spec.name for spec in TOYS))
"""All that there are, the toys included."""
