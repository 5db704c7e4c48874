"""A controller of a sector in ten lines, in the form of the public BluebirdDT challenge.

    skystack flight-school examples/own_controller.py:ToExitLevel

It sends every flight direct to its next fix, and clears it to its exit level in steps of ten flight
levels. A list of actions is issued in one transmission.
"""


class ToExitLevel:
    def generate_action(self, env, observation, info):
        chosen = {}
        for callsign, flight in info["simulator_environment"].aircraft.items():
            change = round((flight.flight_plan.exit_fl - flight.selected_fl) / 10)
            level = env.actions["climb 10 FL" if change > 0 else "descend 10 FL"]
            direct = [] if flight.on_route else [env.actions["direct"]]
            chosen[callsign] = direct + [level] * abs(change)
        return chosen
