"""Gymnasium environments of the tasks; importing this module registers them.

`skystack/Lateral-v0`, `skystack/LateralLarge-v0`, `skystack/Vertical-v0` and
`skystack/Avoidance-v0` are the paper's experiments, for `gymnasium.make` and `gymnasium.make_vec`.
`skystack.gym.registration` documents the keyword arguments. JAX is imported when the first
environment is created and starts at its first reset.
"""

from gymnasium import register

import skystack.compilation.forks  # noqa: F401  (records forks from now on)

REGISTERED = {
    "skystack/Lateral-v0": "lateral",
    "skystack/LateralLarge-v0": "lateral-large",
    "skystack/Vertical-v0": "vertical",
    "skystack/Avoidance-v0": "avoidance",
}
"""The experiment of each environment."""

for _name, _experiment in REGISTERED.items():
    register(
        _name,
        entry_point="skystack.gym.registration:make_environment",
        vector_entry_point="skystack.gym.registration:make_vector_environment",
        kwargs={"experiment": _experiment},
    )
