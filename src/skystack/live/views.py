"""What pages show of trials, approaches and advice, as values for JSON."""

from typing import Any

from skystack.live.advice import Advice, Alternative
from skystack.live.hour import LiveHour
from skystack.live.what_if import CloseApproach, Trial, WhatIf
from skystack.platforms.phraseology import clearance_alone, written
from skystack.simulator.simulator import CYCLE_S

PATH_EVERY = 5
"""A predicted path is sent with one point per this many cycles."""
APPROACHES = 5
"""The maximum number of approaches of a trial."""


class Views:
    """Describes the present of an hour."""

    def __init__(self, hour: LiveHour, what_if: WhatIf) -> None:
        self._hour, self._what_if = hour, what_if

    def monitor(self) -> dict[str, Any]:
        """The pairs that will come close as cleared, the soonest first."""
        name, state = self._hour.callsigns, self._hour.state
        pairs = [
            self._approach(each)
            | {
                "callsigns": [name[slot], name[each.slot]],
                "lost_at": self._places(each.lost_in_s, slot, each.slot),
            }
            for slot, each in self._what_if.closest(state)
        ]
        return {"cycle": self._hour.cycle, "pairs": sorted(pairs, key=lambda each: each["in_s"])}

    def trial(self, trial: Trial) -> dict[str, Any]:
        """A trial, with its path."""
        path = trial.position_nm[::PATH_EVERY]
        first = trial.plan[0].transmission
        return {
            "callsign": self._hour.callsigns[first.slot],
            "words": written(self._hour.phrased(first)),
            "path": path.round(3).tolist(),
            "path_s": PATH_EVERY * CYCLE_S,
            "leaves_correctly": trial.leaves_correctly,
            "approaches": [self._approach(each) for each in trial.approaches[:APPROACHES]],
            "least_nm": rounded(trial.least_nm),
            "lost_in_s": trial.lost_in_s,
        }

    def advice(self, advice: Advice, until_cycle: int) -> dict[str, Any]:
        """Advice with all its alternatives, which can be accepted until a cycle."""
        concern, name = advice.concern, self._hour.callsigns
        return {
            "number": advice.number,
            "cycle": advice.cycle,
            "until_cycle": until_cycle,
            "kind": concern.kind,
            "callsigns": [name[slot] for slot in concern.slots],
            "lost_in_s": concern.lost_in_s,
            "least_nm": rounded(concern.least_nm),
            "alternatives": [self._alternative(each) for each in advice.alternatives],
        }

    def _alternative(self, alternative: Alternative) -> dict[str, Any]:
        first, *later = alternative.trial.plan
        certainty = alternative.certainty
        return self.trial(alternative.trial) | {
            "later": [
                {
                    "after_s": each.wait * CYCLE_S,
                    "words": clearance_alone(self._hour.phrased(each.transmission)),
                }
                for each in later
            ],
            "source": alternative.source,
            "instructions": first.transmission.instructions,
            "extra_nm": rounded(alternative.extra_nm),
            "level_change_fl": alternative.level_change_fl,
            "probability": None if certainty is None else rounded(certainty.probability),
            "entropy": None if certainty is None else rounded(certainty.entropy),
            "agrees": alternative.agrees,
        }

    def _places(self, in_s: float | None, *slots: int) -> list[list[float]] | None:
        """Where flights will be as cleared, after so many seconds; None if that is None."""
        if in_s is None:
            return None
        ahead = self._what_if.as_cleared(self._hour.state).ahead
        at = ahead.position_nm[round(in_s / CYCLE_S), list(slots)]
        places: list[list[float]] = at.round(3).tolist()
        return places

    def _approach(self, approach: CloseApproach) -> dict[str, Any]:
        return {
            "callsign": self._hour.callsigns[approach.slot],
            "least_nm": rounded(approach.least_nm),
            "in_s": approach.in_s,
            "lost_in_s": approach.lost_in_s,
        }


def rounded(value: float | None) -> float | None:
    """Two decimals."""
    return None if value is None else round(value, 2)
