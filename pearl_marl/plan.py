"""The former place of :func:`pearl_marl.latency.plan`, for one version."""

import warnings

from pearl_marl.latency.planning import Candidate, Plan, plan

__all__ = ["Candidate", "Plan", "plan"]

warnings.warn("pearl_marl.plan is deprecated: use pearl_marl.latency.plan", DeprecationWarning, stacklevel=2)
