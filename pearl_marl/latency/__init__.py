"""How long a step takes with the hardware behind a link: the paper's latency model, with measured inputs.

::

    T1 pack -> T2 write -> T3 words in, T4 compute, T5 words out -> T6 read -> T7 unpack
    host       link        hardware                                link       host

T1 and T7 are measured on this machine, by stepping the host's half of the protocol without hardware
(:func:`measure_host` in ``host.py``). T3 to T5 are counted: clock cycles from the memory map and the
core's timing (:func:`step_cycles` in ``cycles.py``), as the simulated device takes them. T2 and T6 come
from a :class:`Link`: so much for a call, so much for a byte. ``prediction.py`` adds all of them up, and
:func:`plan` chooses a build by what they predict.

A rollout with a policy engine is counted likewise (:func:`rollout_step_cycles` in ``rollouts.py``).

Where the paper's hardware takes T3, T4 and T5 partly one after the other (its Eq. 2 and 3, see
:class:`~pearl_marl.latency.cycles.LoopCycles`), this one does all three at the same time. Its form without
pipeline, which the paper compares with, is :func:`predict` with ``pipelined=False``.
"""

from pearl_marl.latency.cycles import axi_cycles, draws_wait, loop_cycles, step_cycles
from pearl_marl.latency.host import HostTimes, measure_host
from pearl_marl.latency.planning import plan
from pearl_marl.latency.prediction import LINKS, Link, predict
from pearl_marl.latency.rollouts import rollout_step_cycles

__all__ = [
    "LINKS",
    "HostTimes",
    "Link",
    "axi_cycles",
    "draws_wait",
    "loop_cycles",
    "measure_host",
    "plan",
    "predict",
    "rollout_step_cycles",
    "step_cycles",
]
