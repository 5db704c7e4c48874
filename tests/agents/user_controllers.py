"""Controllers as users write them, right and wrong, for tests."""

import os
import sys
import time


class Nobody:
    """Instructs nobody."""

    def generate_action(self, env, observation, info):
        return {}


class Notebook:
    """The form of the challenge's notebook: action numbers from the parser, positions from info."""

    def generate_action(self, env, observation, info):
        names = env.get_action_parser().action_formatter_map
        (left,) = (number for number, name in names.items() if name == "simple_heading_left__10")
        aircraft = info["simulator_environment"].aircraft
        return {name: left if aircraft[name].lat > 0.0 else 0 for name in observation}


class Bursts:
    """Climbs by 20 levels in one burst."""

    def generate_action(self, env, observation, info):
        return {name: [env.actions["climb 10 FL"]] * 2 for name in observation}


class ChangesFolder:
    """Changes the working directory of its process."""

    def __init__(self):
        os.chdir("/")

    def generate_action(self, env, observation, info):
        return {}


class Raises:
    def generate_action(self, env, observation, info):
        raise ValueError("two\nlines")


class Overwhelmed:
    """Fails when it has five flights."""

    def generate_action(self, env, observation, info):
        if len(observation) == 5:
            raise RuntimeError("too many flights")
        return {}


class NoSuchAction:
    def generate_action(self, env, observation, info):
        return dict.fromkeys(observation, 6)


class NoSuchFlight:
    def generate_action(self, env, observation, info):
        return {"BAW12": 0}


class Everybody:
    """Addresses every flight that it has ever seen."""

    def __init__(self):
        self.seen = {}

    def generate_action(self, env, observation, info):
        self.seen |= dict.fromkeys(observation, 0)
        return self.seen


class Lists:
    def generate_action(self, env, observation, info):
        return [0, 1]


class NeedsAnArgument:
    def __init__(self, argument):
        self.argument = argument

    def generate_action(self, env, observation, info):
        return {}


class Prints(Nobody):
    def generate_action(self, env, observation, info):
        sys.stdout.write("thinking\n")
        return {}


class Hangs:
    """Takes ten minutes for the third decision."""

    def __init__(self):
        self.cycle = 0

    def generate_action(self, env, observation, info):
        self.cycle += 1
        if self.cycle == 3:
            time.sleep(600.0)
        return {}


class Dies(Hangs):
    """Its process dies in the third decision."""

    def generate_action(self, env, observation, info):
        self.cycle += 1
        if self.cycle == 3:
            os._exit(7)
        return {}


class Silent:
    """Has no method `generate_action`."""
