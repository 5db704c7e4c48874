"""Online action-stacking in your own environment: a thermostat that is set in small steps.

Setting the dial takes no time; heating does. Stacking needs the two as separate methods: in
addition to `reset` and `step`, the environment has `observe`, `may_stack`, `instruct` and
`advance`. A rule sends "half a degree warmer" until the dial is right: eight messages, or one when
stacked.
"""

import gymnasium
import numpy as np
from gymnasium import spaces

from skystack.gym.stacked import StackedEnvironment

WARMER, COOLER, CYCLES = 1, 2, 30


class Thermostat(gymnasium.Env):
    """Keep a room at a target temperature. Observation: room, dial and target, degrees C."""

    observation_space = spaces.Box(0.0, 40.0, (3,), np.float32)
    action_space = spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.room = self.dial = 17.0
        self.target, self.cycle = 21.0, 0
        return self.observe(), {}

    def step(self, action):
        self.instruct(action)
        outcome = self.advance()
        return self.observe(), *outcome

    def observe(self):
        return np.array([self.room, self.dial, self.target], dtype=np.float32)

    def may_stack(self, action):
        return 5.0 < self.dial < 30.0

    def instruct(self, action):
        self.dial += {WARMER: 0.5, COOLER: -0.5}.get(int(action), 0.0)

    def advance(self):
        self.cycle += 1
        self.room += 0.3 * (self.dial - self.room)
        return -abs(self.room - self.target), self.cycle == CYCLES, False, {}


def rule(observation):
    _, dial, target = observation
    return WARMER if dial < target else COOLER if dial > target else 0


for title, limit in (("one at a time", 1), ("stacked", 100)):
    environment = StackedEnvironment(Thermostat(), limit)
    (observation, _), ended, error, messages = environment.reset(), False, 0.0, 0
    while not ended:
        observation, reward, ended, _, info = environment.step(rule(observation))
        error -= reward
        messages += "clearance" in info and info["clearance"]["instructions"] > 0
    print(f"{title}: messages {messages}, mean error {error / CYCLES:.2f} degrees")
