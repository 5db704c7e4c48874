"""Online action-stacking round a policy of another library, here an ONNX session.

Exports a shipped policy as ONNX, forgets it, and flies one scenario with the session alone: to
`skystack.stacking.stack` a policy is whatever turns an observation into an action. Run it with

    python examples/onnx_session.py

where skystack is installed with the extra [onnx]; it prints the clearances of one scenario and
from how many instructions each was stacked.
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
    """The most probable action; the session takes batches."""
    (actions,) = session.run(["action"], {"observation": observation[None]})
    return int(actions[0])


environment = PlainTask(task)
seen = environment.reset(scenario_key(seed=0, scenario=2))
cycle, over = 0, False
while not over:
    seen, clearance = stack(environment, decide, seen)  # no time passes
    cleared_deg = environment.state_of(seen).traffic.cleared_heading_deg
    seen, outcome = environment.advance(seen)  # one radar cycle
    if clearance.instructions:
        # The clearance is adopted at the end of the cycle: from there the turn is flown.
        flown = environment.state_of(seen).traffic
        who, _ = task.actions.changes[clearance.action - 1]
        command = Instruction(f"AC{who + 1}", heading_deg=int(cleared_deg[who]))
        heading_deg, level = (
            np.array([each[who]]) for each in (flown.heading_deg, flown.level_ticks)
        )
        (said,) = in_words([command], heading_deg, level / TICKS_PER_FL, SKYSTACK)
        print(f"{6 * cycle:4d} s  {written(said)} (from {clearance.instructions})")
    cycle, over = cycle + 1, bool(outcome.terminated)
print(f"success: {bool(outcome.metrics.success)}")
