"""Gymnasium environments of the tasks; importing this registers them.

`skystack/Lateral-v0`, `skystack/LateralLarge-v0`, `skystack/Vertical-v0` and
`skystack/Avoidance-v0`: the paper's experiments, for `gymnasium.make` and `gymnasium.make_vec`.
Keywords are those of `skystack.gym.registration`. JAX is imported when the first one is made,
and started by its first reset.
"""

from gymnasium import register

import skystack.compilation.forks  # noqa: F401  (notes every fork from now on)

REGISTERED = {
    "skystack/Lateral-v0": "lateral",
    "skystack/LateralLarge-v0": "lateral-large",
    "skystack/Vertical-v0": "vertical",
    "skystack/Avoidance-v0": "avoidance",
}
"""Each environment's experiment."""

for _name, _experiment in REGISTERED.items():
    register(
        _name,
        entry_point="skystack.gym.registration:make_environment",
        vector_entry_point="skystack.gym.registration:make_vector_environment",
        kwargs={"experiment": _experiment},
    )
