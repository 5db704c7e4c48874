"""Online action-stacking with a policy of another library, here an ONNX session.

Exports a shipped policy as ONNX, then flies one scenario with an onnxruntime session as the policy:
for `skystack.stacking.stack`, a policy is any function from an observation to an action. Run

    python examples/onnx_session.py

in an environment where skystack is installed with the extra `[onnx]`. It prints the clearances of
the scenario and the number of instructions in each.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnxruntime

from skystack.evaluation.evaluate import policy_task
from skystack.export.onnx_file import export_onnx
from skystack.learning.seeds import scenario_key
from skystack.platforms.adoption import SKYSTACK, in_words
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import written
from skystack.policies.shipped import find_policy
from skystack.simulator.performance import TICKS_PER_FL
from skystack.stacking import stack
from skystack.tasks.plain import PlainTask

policy = find_policy("lateral-best")
task = policy_task(policy)
with TemporaryDirectory() as folder:
    path = Path(folder) / "lateral-best.onnx"
    export_onnx(policy, path)
    session = onnxruntime.InferenceSession(path)


def decide(observation: np.ndarray) -> int:
    """The most probable action; the session expects a batch."""
    (actions,) = session.run(["action"], {"observation": observation[None]})
    return int(actions[0])


environment = PlainTask(task)
state = environment.reset(scenario_key(seed=0, scenario=1))
cycle, ended = 0, False
while not ended:
    state, clearance = stack(environment, decide, state)  # no time passes
    cleared_deg = environment.state_of(state).traffic.cleared_heading_deg
    state, outcome = environment.advance(state)  # one radar cycle
    if clearance.instructions:
        # The clearance is adopted at the end of the cycle, which decides the direction in words.
        traffic = environment.state_of(state).traffic
        index = task.actions[clearance.action].aircraft
        command = Instruction(f"AC{index + 1}", heading_deg=int(cleared_deg[index]))
        heading_deg = np.array([traffic.heading_deg[index]])
        level_fl = np.array([traffic.level_ticks[index]]) / TICKS_PER_FL
        (worded,) = in_words([command], heading_deg, level_fl, SKYSTACK)
        print(f"{6 * cycle:4d} s  {written(worded)} (from {clearance.instructions})")
    cycle, ended = cycle + 1, bool(outcome.ended)
print(f"success: {bool(outcome.metrics['success'])}")
