"""How long a step takes with the hardware behind a link.

May import ``devices``, ``hardware`` and what is below them.
"""

from pearl_marl.latency.prediction import LINKS, HostTimes, Link, axi_cycles, measure_host, predict

__all__ = ["LINKS", "HostTimes", "Link", "axi_cycles", "measure_host", "predict"]
