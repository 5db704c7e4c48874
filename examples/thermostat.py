"""Your own environment gains online action-stacking: a thermostat that is told in small steps.

Telling takes no time, and heating does. Stacking needs the two apart: four methods beside `reset`
and `step`. A rule says "half a degree more" until the dial is right: eight messages, or one.
"""

import gymnasium
import numpy as np
from gymnasium import spaces

from skystack.gym.stacked import StackedEnvironment

WARMER, COOLER, CYCLES = 1, 2, 30


class Thermostat(gymnasium.Env):
    """Keep a room at what is wanted. Observation: room, dial and wanted temperature, degrees C."""

    observation_space = spaces.Box(0.0, 40.0, (3,), np.float32)
    action_space = spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.room = self.dial = 17.0
        self.wanted, self.cycle = 21.0, 0
        return self.observe(), {}

    def step(self, action):
        self.instruct(action)
        outcome = self.advance()
        return self.observe(), *outcome

    def observe(self):
        return np.array([self.room, self.dial, self.wanted], dtype=np.float32)

    def may_stack(self, action):
        return 5.0 < self.dial < 30.0

    def instruct(self, action):
        self.dial += {WARMER: 0.5, COOLER: -0.5}.get(int(action), 0.0)

    def advance(self):
        self.cycle += 1
        self.room += 0.3 * (self.dial - self.room)
        return -abs(self.room - self.wanted), self.cycle == CYCLES, False, {}


def rule(seen):
    _, dial, wanted = seen
    return WARMER if dial < wanted else COOLER if dial > wanted else 0


for title, limit in (("one at a time", 1), ("stacked", 100)):
    environment = StackedEnvironment(Thermostat(), limit)
    (seen, _), over, off, messages = environment.reset(), False, 0.0, 0
    while not over:
        seen, reward, over, _, info = environment.step(rule(seen))
        off -= reward
        messages += "clearance" in info and info["clearance"]["instructions"] > 0
    print(f"{title}: messages {messages}, degrees off {off / CYCLES:.2f}")
