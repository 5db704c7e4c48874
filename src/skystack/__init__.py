"""skystack: online action-stacking for air traffic control.

What most programs need stands here; each name is loaded when it is first used.

    find_policy       a shipped policy by name, or that of a run folder: a callable of numpy
    find_agent        the same, or the policy in a file: ONNX, Stable-Baselines3
    evaluate          fly a policy, also a function, on held-out scenarios, under `Conditions`
    Batched           marks a function of many observations at once as a policy
    load_experiment   a task and how it is learned, by name or from a TOML file
    train_experiment  train it into a folder
    build_task        the task of an experiment's settings
    find_sector       a sector by name or from a file
    PlainTask         a task for plain Python: one scenario, numpy observations
    stack             online action-stacking of any policy over anything `TwoPhase`
    InputError        what every mistake in names, files and settings is raised as
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skystack.agents.agent import Batched
    from skystack.agents.find import find_agent
    from skystack.airspace.sectors import find_sector
    from skystack.errors import InputError
    from skystack.evaluation.evaluate import Conditions, evaluate
    from skystack.learning.experiment import load_experiment
    from skystack.learning.run import train_experiment
    from skystack.policies.shipped import find_policy
    from skystack.stacking import Stack, TwoPhase, stack
    from skystack.tasks.build import build_task
    from skystack.tasks.plain import PlainTask

__version__ = "0.1.0"

__all__ = [
    "Batched",
    "Conditions",
    "InputError",
    "PlainTask",
    "Stack",
    "TwoPhase",
    "__version__",
    "build_task",
    "evaluate",
    "find_agent",
    "find_policy",
    "find_sector",
    "load_experiment",
    "stack",
    "train_experiment",
]

_MODULES = {
    "Batched": "agents.agent",
    "Conditions": "evaluation.evaluate",
    "InputError": "errors",
    "PlainTask": "tasks.plain",
    "Stack": "stacking",
    "TwoPhase": "stacking",
    "build_task": "tasks.build",
    "find_agent": "agents.find",
    "find_policy": "policies.shipped",
    "find_sector": "airspace.sectors",
    "evaluate": "evaluation.evaluate",
    "load_experiment": "learning.experiment",
    "stack": "stacking",
    "train_experiment": "learning.run",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'skystack' has no attribute {name!r}")
    return getattr(import_module(f"skystack.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
